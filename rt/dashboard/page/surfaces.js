// SPDX-License-Identifier: Apache-2.0
// CT surface and reconstruction in the camera's frame, by three.js; with a distance at each vertex
// the reconstruction is a heat map. Drag turns, wheel zooms, arrow keys turn too. Drawn only when
// something changes.
import * as THREE from "./three.module.js";

const kHeatMaxMm = 1;
const kUnknown = new THREE.Color(0x777777);

/// rt/dashboard/surface_files.hpp PackedSurface.
function unpack(buffer) {
  const head = new DataView(buffer);
  if (new TextDecoder().decode(buffer.slice(0, 4)) !== "HFM1") throw new Error("not a packed surface");
  const [vertices, triangles, has_distance] = [4, 8, 12].map((at) => head.getUint32(at, true));
  const positions = new Float32Array(buffer, 16, 3 * vertices);
  const distances = has_distance ? new Float32Array(buffer, 16 + 12 * vertices, vertices) : null;
  const indices = new Uint32Array(buffer, 16 + (has_distance ? 16 : 12) * vertices, 3 * triangles);
  return { positions, distances, indices };
}

/// 0 blue, half the scale yellow, its end red; grey where no CT surface is near.
function heat(distance_mm) {
  if (!Number.isFinite(distance_mm)) return kUnknown;
  return new THREE.Color().setHSL((1 - Math.min(distance_mm / kHeatMaxMm, 1)) * 0.62, 0.9, 0.55);
}

function mesh_of({ positions, distances, indices }, name) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
  if (indices.length > 0) geometry.setIndex(new THREE.BufferAttribute(indices, 1));
  if (distances) {
    const colours = new Float32Array(3 * distances.length);
    distances.forEach((d, i) => heat(d).toArray(colours, 3 * i));
    geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  }
  const colour = distances ? 0xffffff : name === "ct" ? 0xe6dcc8 : 0x7cc4ff;
  if (indices.length === 0)
    return new THREE.Points(geometry, new THREE.PointsMaterial({ color: colour, vertexColors: !!distances, size: 0.15 }));
  geometry.computeVertexNormals();
  return new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: colour, vertexColors: !!distances,
    side: THREE.DoubleSide, transparent: name === "ct", opacity: name === "ct" ? 0.55 : 1 }));
}

/// Turns `camera` about `centre`; calls `changed` after each change.
function orbit(canvas, camera, centre, radius, changed) {
  let [yaw, pitch, distance] = [0, 0, 2.4 * radius];
  const place = () => {
    pitch = Math.max(-1.5, Math.min(1.5, pitch));
    distance = Math.max(0.2 * radius, Math.min(20 * radius, distance));
    // y down, z away from the eye, as the camera's frame has them.
    camera.up.set(0, -1, 0);
    camera.position.set(Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), -Math.cos(yaw) * Math.cos(pitch))
      .multiplyScalar(distance).add(centre);
    camera.lookAt(centre);
    changed();
  };
  canvas.addEventListener("pointermove", (e) => {
    if (e.buttons === 0) return;
    yaw -= e.movementX / 150; pitch -= e.movementY / 150; place();
  });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); distance *= Math.exp(e.deltaY / 800); place(); }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
    if (step) { e.preventDefault(); yaw += step[0]; pitch += step[1]; place(); }
  });
  place();
}

export async function show_surfaces(names) {
  const host = document.getElementById("surfaces");
  const note = document.getElementById("surfaces-note");
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: true });
  } catch {
    note.textContent = "this browser has no WebGL";
    return;
  }
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0x19212b);
  scene.add(new THREE.HemisphereLight(0xffffff, 0x555566, 2.5));
  for (const name of names) {
    const buffer = await (await fetch(`/surfaces/${name}`)).arrayBuffer();
    scene.add(mesh_of(unpack(buffer), name));
  }
  const has_heat = scene.children.some((object) => object.geometry?.hasAttribute("color"));
  note.textContent = names.join(", ") + (has_heat ? `; distance to CT: blue 0, red ≥ ${kHeatMaxMm} mm, grey unknown` : "");
  const focus = scene.children.findLast((object) => object.geometry); // the reconstruction, if there is one
  focus.geometry.computeBoundingSphere();
  const { center, radius } = focus.geometry.boundingSphere;
  const camera = new THREE.PerspectiveCamera(40, 1, radius / 100, 100 * radius);
  let is_due = false;
  const draw = () => {
    if (is_due) return;
    is_due = true;
    requestAnimationFrame(() => { is_due = false; renderer.render(scene, camera); });
  };
  const canvas = renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `Surfaces: ${names.join(", ")}; arrow keys turn the view`);
  host.append(canvas);
  new ResizeObserver(() => {
    renderer.setSize(host.clientWidth, host.clientHeight, false);
    camera.aspect = host.clientWidth / Math.max(1, host.clientHeight);
    camera.updateProjectionMatrix();
    draw();
  }).observe(host);
  orbit(canvas, camera, center, radius, draw);
  host.dataset.drawn = names.length;
}

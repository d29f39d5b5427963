// SPDX-License-Identifier: Apache-2.0
// The camera's picture with what the tracker says of it. An old picture must never pass for the
// present: each is shown until kShownMs after its exposure, then the cover comes up by itself, and
// the picture is wiped.
import { ask, Cover } from "./freshness.js";

const kPeriodMs = 66; // 15 a second
const kPatienceMs = 500;
const kShownMs = 1000; // from exposure
const kScale = 2; // canvas pixels a pixel of the picture, for the lines upon it
const kInlier = "#7ce38b", kMasked = [255, 92, 214], kMotion = "#ffd166";

const by_id = (id) => document.getElementById(id);
const canvas = by_id("live");
const note = by_id("live-note");
const cover = new Cover(by_id("live-cover"), kShownMs);
let shown = null; // frame and exposure of what is drawn

/// rt/dashboard/live_answer.hpp.
function unpack(buffer) {
  const head = new DataView(buffer);
  if (new TextDecoder().decode(buffer.slice(0, 4)) !== "HFL1") throw new Error("not a live answer");
  const [text, mask] = [head.getUint32(4, true), head.getUint32(8, true)];
  return {
    ...JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 12, text))),
    mask: new Uint8Array(buffer, 12 + text, mask),
    jpeg: new Uint8Array(buffer, 12 + text + mask),
  };
}

function set_note(text) {
  if (note.textContent !== text) note.textContent = text;
}

function wipe() {
  shown = null;
  delete document.body.dataset.live;
  canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
}

function draw_mask(g, { mask, width_px, height_px }) {
  const [columns, rows] = [width_px / 4, height_px / 4];
  const image = new ImageData(columns, rows);
  for (let i = 0; i < mask.length; ++i) image.data.set([...kMasked, 0.6 * mask[i]], 4 * i);
  const small = new OffscreenCanvas(columns, rows);
  small.getContext("2d").putImageData(image, 0, 0);
  g.imageSmoothingEnabled = false;
  g.drawImage(small, 0, 0, canvas.width, canvas.height);
}

/// Tenths of the picture's pixels, whose centres are whole, to the canvas.
const place = (tenths) => kScale * (tenths / 10 + 0.5);

function draw_points(g, points) {
  g.fillStyle = kInlier;
  for (let i = 0; i < points.length; i += 2) {
    g.beginPath();
    g.arc(place(points[i]), place(points[i + 1]), 2 * kScale, 0, 2 * Math.PI);
    g.fill();
  }
}

/// From where the site's point on the axis was at the keyframe to where it is.
function draw_motion(g, from, to) {
  const [[x0, y0], [x1, y1]] = [from.map(place), to.map(place)];
  for (const [colour, width] of [["#000000", 4 * kScale], [kMotion, 2 * kScale]]) {
    g.strokeStyle = g.fillStyle = colour;
    g.lineWidth = width;
    g.beginPath(); g.arc(x0, y0, 6 * kScale, 0, 2 * Math.PI); g.moveTo(x0, y0); g.lineTo(x1, y1); g.stroke();
    g.beginPath(); g.arc(x1, y1, 1.5 * width, 0, 2 * Math.PI); g.fill();
  }
}

function draw(bitmap, answer) {
  canvas.width = kScale * answer.width_px;
  canvas.height = kScale * answer.height_px;
  const g = canvas.getContext("2d");
  g.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  bitmap.close();
  if (!by_id("live-overlay").checked) return;
  draw_mask(g, answer);
  draw_points(g, answer.points_tenth_px);
  if (answer.from_tenth_px) draw_motion(g, answer.from_tenth_px, answer.to_tenth_px);
}

function show_absence({ why, since_ms }) {
  cover.animation.finish();
  wipe();
  const since = typeof since_ms === "number" ? ` since ${(since_ms / 1000).toFixed(0)} s` : "";
  set_note(`no live picture${since}: ${why}`);
}

async function show(answer, asked_ms) {
  if (answer.why !== null) return show_absence(answer);
  const exposed_ms = asked_ms - answer.age_ms; // or later: the question was before the answer
  if (answer.frame !== shown) {
    const bitmap = await createImageBitmap(new Blob([answer.jpeg], { type: "image/jpeg" }));
    draw(bitmap, answer);
    shown = answer.frame;
    document.body.dataset.live = answer.frame;
  }
  if (!cover.renew(exposed_ms)) return wipe();
  const is_good = answer.status === "tracking" || answer.status === "relocalised";
  set_note(`${answer.age_ms.toFixed(0)} ms old; ${is_good ? answer.status : `${answer.status}: ${answer.reason}`}`);
}

ask("/live", kPeriodMs, kPatienceMs, async (buffer, asked_ms) => show(unpack(buffer), asked_ms),
  (response) => response.arrayBuffer());
cover.animation.addEventListener("finish", () => {
  wipe();
  if (!note.textContent.startsWith("no live picture")) set_note("no live picture: no answer from the dashboard");
});

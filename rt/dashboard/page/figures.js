// SPDX-License-Identifier: Apache-2.0
// Lists and tables of the page. A number that is not known shows as "–", a device of which nothing
// is heard as "no data".

const by_id = (id) => document.getElementById(id);
const figure = (value, digits, unit) => (typeof value === "number" ? `${value.toFixed(digits)} ${unit}` : "–");

/// Rows of [term, text, class]; kept from one call to the next, only texts change.
function show_list(list, rows) {
  while (list.children.length > 2 * rows.length) list.lastElementChild.remove();
  while (list.children.length < 2 * rows.length)
    list.append(document.createElement(list.children.length % 2 === 0 ? "dt" : "dd"));
  rows.forEach(([term, text, kind = ""], i) => {
    const [dt, dd] = [list.children[2 * i], list.children[2 * i + 1]];
    if (dt.textContent !== term) dt.textContent = term;
    if (dd.textContent !== text) dd.textContent = dd.title = text;
    if (dd.className !== kind) dd.className = kind;
  });
}

export function show_tracking(t) {
  const list = by_id("tracking");
  draw_vector(t);
  if (!t) return show_list(list, [["Status", "no data", "unknown"]]);
  const is_good = t.status === "tracking" || t.status === "relocalised";
  show_list(list, [
    ["Status", is_good ? t.status : `${t.status}: ${t.reason}`, is_good ? "good" : "bad"],
    ["Right, down", `${figure(t.dx_um, 0, "µm")}, ${figure(t.dy_um, 0, "µm")}`],
    ["Rotation", figure(t.rotation_mrad, 2, "mrad")],
    ["Scale", figure(t.scale, 4, "")],
    ["Drift", figure(t.drift_um, 1, "µm")],
    ["Residual", figure(t.rms_px, 2, "px")],
    ["Inliers", `${t.inliers} of ${t.matches}, spread ${figure(t.inlier_spread, 2, "")}`],
    ["Target ±1σ", figure(t.sigma_target_mm, 3, "mm")],
  ]);
}

/// The motion in the image plane as an arrow; the ring's radius is written beside it.
function draw_vector(t) {
  const canvas = by_id("vector");
  const g = canvas.getContext("2d");
  const c = canvas.width / 2;
  g.clearRect(0, 0, canvas.width, canvas.height);
  g.strokeStyle = "#8fa1b5";
  g.lineWidth = 1;
  g.beginPath();
  g.arc(c, c, c - 16, 0, 2 * Math.PI);
  g.moveTo(c - 6, c); g.lineTo(c + 6, c);
  g.moveTo(c, c - 6); g.lineTo(c, c + 6);
  g.stroke();
  g.fillStyle = "#eef2f6";
  g.font = "12px sans-serif";
  if (typeof t?.dx_um !== "number") return g.fillText("no motion known", 24, 12);
  const length_um = Math.hypot(t.dx_um, t.dy_um);
  const ring_um = [100, 300, 1000, 3000, 10000, 30000].find((r) => length_um <= r) ?? 100000;
  g.fillText(`ring ${ring_um} µm`, 2, 12);
  const k = (c - 16) / ring_um;
  const [x, y] = [c + k * t.dx_um, c + k * t.dy_um];
  g.strokeStyle = g.fillStyle = "#7cc4ff";
  g.lineWidth = 3;
  g.beginPath(); g.moveTo(c, c); g.lineTo(x, y); g.stroke();
  g.beginPath(); g.arc(x, y, 5, 0, 2 * Math.PI); g.fill();
}

const count = (n) => (typeof n === "number" ? String(n) : "–");

function faults_row(term, faults, good) {
  if (!faults) return [term, "no data", "unknown"];
  const wrong = faults.filter((f) => f.severity !== "advisory");
  if (wrong.length > 0) return [term, wrong.map((f) => f.text).join("; "), "bad"];
  return faults.length > 0 ? [term, faults[0].text, "unknown"] : [term, good, "good"];
}

export function show_devices({ camera, microscope, robot, guard, loop, daemon, messages_refused }) {
  const rows = [faults_row("Camera", camera?.faults, "no fault reported")];
  rows.push(["Frames, not whole", `${count(camera?.received)}, ${count(camera?.incomplete)}; missing ${count(camera?.missing)}`]);
  rows.push(["Camera clock ±1σ", figure(camera?.clock_sigma_us, 0, "µs")]);
  rows.push(faults_row("Microscope (CAN)", microscope?.faults, "no fault reported"));
  rows.push(robot ? ["Robot", robot.has_fault ? `fault ${robot.fault_code}` : robot.is_enabled ? "enabled" : "not enabled",
    robot.has_fault ? "bad" : "good"] : ["Robot", "no data", "unknown"]);
  rows.push(guard ? ["Guard", guard.is_permitted ? "permits" : guard.text, guard.is_permitted ? "good" : "bad"]
    : ["Guard", "no data", "unknown"]);
  rows.push(daemon ? ["Daemon", `${daemon.mode}, ${(daemon.for_ms / 1000).toFixed(1)} s`] : ["Daemon", "no data", "unknown"]);
  rows.push(["Loop", loop ? `${loop.missed} cycles missed, step ≤ ${loop.step_max_us} µs` : "–"]);
  rows.push(["Refused or late", `${count(messages_refused)} messages`]);
  show_list(by_id("devices"), rows);
}

export function show_registration(r) {
  if (!r) return show_list(by_id("registration"), [["State", "none in force", "unknown"]]);
  show_list(by_id("registration"), [
    ["State", "in force", "good"],
    ["Predicted TRE", `${figure(r.predicted_tre_mm, 3, "mm")} (1σ, at the target)`],
    ["Target (CT)", r.target_ct_mm.map((x) => x.toFixed(1)).join(", ") + " mm"],
    ["Zoom, focus", `${r.zoom.toFixed(2)}, ${r.focus_mm.toFixed(0)} mm`],
    ["CT", r.ct || "–"],
    ["Checksum", r.checksum],
  ]);
}

function show_items(list, texts) {
  if (list.dataset.shown === texts.join("\n")) return;
  list.dataset.shown = texts.join("\n");
  list.replaceChildren(...texts.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
}

export function show_reasons({ daemon, loop }) {
  const all = [...(daemon?.reasons ?? []), ...(loop?.advisories ?? [])];
  const none = daemon ? "Nothing" : "Nothing is heard from the daemon";
  show_items(by_id("reasons"), all.length > 0 ? all.map((r) => `${r.text} (${r.severity}: ${r.name})`) : [none]);
}

const duration = (ms) => (ms === null ? "lasting" : ms < 1000 ? `${ms.toFixed(0)} ms` : `${(ms / 1000).toFixed(1)} s`);

export function show_stops(stops) {
  const body = by_id("stops");
  const key = JSON.stringify(stops);
  if (body.dataset.shown === key) return;
  body.dataset.shown = key;
  body.replaceChildren(...stops.map((s) => {
    const row = document.createElement("tr");
    const at = new Date(s.t_utc_ms).toLocaleTimeString([], { hour12: false });
    for (const text of [at, duration(s.duration_ms), `${s.word}: ${s.text} (${s.reason})`])
      row.append(Object.assign(document.createElement("td"), { textContent: text }));
    return row;
  }));
}

// SPDX-License-Identifier: Apache-2.0
// Plots over time and the latency histogram, by uPlot. Redrawn ten times a second: the eye needs no
// more, and the page stays light.
import uPlot from "./uplot.js";

const kWindowS = 60;
const kRedrawMs = 100;
const kAxis = { stroke: "#b9c4d0", grid: { stroke: "#2c3846" }, ticks: { stroke: "#2c3846" }, font: "11px sans-serif", size: 46 };
const kTimeAxis = { ...kAxis, size: 24, values: (_, splits) => splits.map((s) => `${s} s`) };
const line = (label, stroke, dash) => ({ label, stroke, dash, width: 2, spanGaps: false, points: { show: false } });

class Plot {
  constructor(id, series, more = {}) {
    this.host = document.getElementById(id);
    this.data = [[], ...series.map(() => [])];
    this.plot = new uPlot({ ...this.size(), cursor: { show: false }, legend: { live: false },
      series: [{}, ...series], axes: [kTimeAxis, kAxis], ...more }, this.data, this.host);
    new ResizeObserver(() => this.plot.setSize(this.size())).observe(this.host);
  }
  size() {
    return { width: Math.max(100, this.host.clientWidth), height: Math.max(60, this.host.clientHeight - 26) };
  }
}

export class Plots {
  constructor() {
    const x = { time: false, range: () => [-kWindowS, 0] };
    const from_zero = { range: (_, __, max) => [0, max > 0 ? 1.15 * max : 1] };
    this.error = new Plot("plot-error",
      [line("±1σ of the target, µm", "#ffd166"), line("drift, µm", "#7cc4ff", [6, 3])], { scales: { x, y: from_zero } });
    this.inliers = new Plot("plot-inliers", [line("inliers", "#7ce38b")], { scales: { x, y: from_zero } });
    const bars = uPlot.paths.bars({ size: [1], align: 1 });
    const histogram = (label, stroke, fill) => ({ label, stroke, fill, paths: bars, points: { show: false } });
    this.latency = new Plot("plot-latency",
      [histogram("exposure to pose, ms", "#7cc4ff", "#7cc4ff55"), histogram("tracker, ms", "#ffd166", "#ffd16655")],
      { scales: { x: { time: false, range: () => [0, 61] }, y: from_zero },
        axes: [{ ...kTimeAxis, values: (_, splits) => splits.map((s) => `${s}`) }, kAxis] });
    this.rows = []; // [time, sigma, drift, inliers]
    this.frame = -1;
    setInterval(() => this.redraw(), kRedrawMs);
  }

  /// One answer's tracking; null leaves a gap.
  add(tracking) {
    if (tracking && tracking.frame === this.frame) return;
    this.frame = tracking?.frame ?? -1;
    const um = (mm) => (typeof mm === "number" ? 1000 * mm : null);
    this.rows.push([performance.now() / 1000, um(tracking?.sigma_target_mm), tracking?.drift_um ?? null,
      tracking?.inliers ?? null]);
  }

  redraw() {
    const now_s = performance.now() / 1000;
    const first = this.rows.findIndex((row) => row[0] >= now_s - kWindowS);
    this.rows.splice(0, first < 0 ? this.rows.length : first);
    const column = (i) => this.rows.map((row) => row[i]);
    const times = this.rows.map((row) => row[0] - now_s);
    this.error.plot.setData([times, column(1), column(2)]);
    this.inliers.plot.setData([times, column(3)]);
  }

  show_latency({ exposure_to_pose: pose, tracker }) {
    const edges = pose.bins.map((_, i) => i);
    this.latency.plot.setData([edges, pose.bins, tracker.bins]);
    const text = (name, h) => (h.count > 0 ? `${name} ${h.p50_ms} / ${h.p99_ms.toFixed(0)}` : `${name} –`);
    document.getElementById("latency").textContent = `ms, p50 / p99: ${text("pose", pose)}, ${text("tracker", tracker)}`;
  }
}

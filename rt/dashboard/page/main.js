// SPDX-License-Identifier: Apache-2.0
// The page: asks, and shows. What may be shown as permitted is decided by the program that answers.
import { ask, Cover } from "./freshness.js";
import { show_devices, show_reasons, show_registration, show_stops, show_tracking } from "./figures.js";
import "./live.js";
import { Plots } from "./plots.js";

const kPeriodMs = 33; // 30 a second
const kLimitMs = 500; // from a question to the end of what its answer may show
const kLevels = ["no_data", "stop", "hold", "not_ready", "permitted"];

const by_id = (id) => document.getElementById(id);
const permission = by_id("permission");
const cover = new Cover(by_id("expired"), kLimitMs);
const plots = new Plots();

function set_text(element, text) {
  if (element.textContent !== text) element.textContent = text; // a screen reader speaks changes only
}

function show_permission({ level, word, text, reason, is_of_guard }) {
  const is_known = kLevels.includes(level) && typeof word === "string" && typeof text === "string";
  permission.className = is_known ? level : "no_data";
  set_text(by_id("word"), is_known ? word : "STOP: NO DATA");
  const whose = is_of_guard ? "Guard: " : "";
  const sentence = level === "permitted" ? text : `${whose}${text} (${reason})`;
  set_text(by_id("reason"), is_known ? sentence : "The answer cannot be read");
  document.title = `${by_id("word").textContent} – Holdfast`;
}

function show_figures(state) {
  show_tracking(state.tracking);
  show_devices(state);
  show_registration(state.registration);
  show_reasons(state);
  plots.add(state.tracking);
}

ask("/state", kPeriodMs, kLimitMs, (state, asked_ms) => {
  if (!cover.renew(asked_ms)) return; // too old to be shown
  show_permission(state.shown ?? {});
  document.body.dataset.answers = Number(document.body.dataset.answers ?? 0) + 1;
  show_figures(state);
});
ask("/history", 1000, 3000, (history) => {
  show_stops(history.stops);
  plots.show_latency(history);
});

// Figures that are no longer known go too; so do the tab's title and what a screen reader hears.
cover.animation.addEventListener("finish", () => {
  show_permission({ level: "no_data", word: "STOP: NO DATA", reason: "dashboard_silent",
    text: "The page hears nothing from the dashboard" });
  show_figures({});
});

const surfaces = await (await fetch("/surfaces")).json();
if (surfaces.length > 0) (await import("./surfaces.js")).show_surfaces(surfaces);

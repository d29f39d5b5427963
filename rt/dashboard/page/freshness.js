// SPDX-License-Identifier: Apache-2.0
// Silence means stop, also for the eye. Each answer was asked for, so it is no older than its
// question: no clock of another machine is believed, and no backlog can pass for the present. A
// permission is shown until `limit_ms` after the question whose answer told it, and no longer.

/// Asks `url` again and again, one question at a time; `show(answer, asked_ms)` gets each answer as
/// `read` has it, asked_ms on performance.now(), and is waited for.
export function ask(url, period_ms, patience_ms, show, read = (response) => response.json()) {
  let asked_ms = 0;
  const next = () => setTimeout(question, Math.max(0, asked_ms + period_ms - performance.now()));
  async function question() {
    asked_ms = performance.now();
    const this_asked_ms = asked_ms;
    try {
      const response = await fetch(url, { cache: "no-store", signal: AbortSignal.timeout(patience_ms) });
      if (response.ok) await show(await read(response), this_asked_ms);
    } catch {
      // No answer, or none that can be read: time passes, and the cover comes up.
    }
    next();
  }
  question();
}

/// Covers `element` unless it is renewed: an animation that ends opaque. The browser runs it apart
/// from our script, so it comes up also when the script hangs.
export class Cover {
  constructor(element, limit_ms) {
    this.limit_ms = limit_ms;
    this.animation = element.animate([{ opacity: 0 }, { opacity: 1 }], {
      duration: limit_ms,
      easing: "step-end",
      fill: "both",
    });
    this.animation.finish(); // covered until the first answer
  }
  /// Uncovered until limit_ms after `asked_ms`; false when that has passed already.
  renew(asked_ms) {
    const age_ms = performance.now() - asked_ms;
    if (!(age_ms >= 0 && age_ms < this.limit_ms)) return false;
    this.animation.currentTime = age_ms;
    this.animation.play();
    return true;
  }
  get is_up() {
    return this.animation.playState === "finished";
  }
}

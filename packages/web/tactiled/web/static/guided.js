// Runs of verbs that guide a person: their prompts, one at a time, and what they found at the end.

import { put } from "./dom.js";
import { clockWords } from "./words.js";

const TICK_MS = 250;

/**
 * Guide of an element with .step, .said, .left, .seconds and .cancel. Return a function that runs a verb:
 * `button` stays disabled until it has ended, `ask(signal)` asks the server, `show(found)` shows the result.
 */
export function makeGuide(root) {
  const at = (selector) => root.querySelector(selector);
  const cancel = at(".cancel"), step = at(".step"), left = at(".left"), said = at(".said");
  let run = null, until = null, reports = false;

  function showLeft() {
    const seconds = until === null ? 0 : Math.max(0, (until - performance.now()) / 1000);
    left.value = seconds;
    left.hidden = seconds === 0;
    put(at(".seconds"), seconds > 0 ? `${Math.ceil(seconds)} s` : "");
  }

  function countDown(seconds) {
    if (until === null) left.max = Math.max(1, seconds); // the first of its step
    until = performance.now() + 1000 * seconds;
  }

  function take(line, show) {
    if (line.left_s !== undefined) { countDown(line.left_s); return; }
    if (line.words !== undefined) {
      until = null;
      said.textContent += `${line.words}\n`;
      if (line.words !== "" && !reports) put(step, line.words.trim());
      reports ||= line.words.endsWith(" ..."); // the report follows, as a whole
    }
    if (line.ok === true) show(line.found);
    if (line.ok === false) put(step, `It ended without a result: ${line.reason}`);
  }

  cancel.onclick = () => run.abort();

  return async (button, ask, show) => {
    run = new AbortController();
    reports = false;
    said.textContent = "";
    button.disabled = true; cancel.disabled = false;
    cancel.focus();
    put(step, "Starting\u2026");
    const ticking = setInterval(showLeft, TICK_MS);
    try { await follow(await ask(run.signal), (line) => take(line, show)); }
    catch (error) { put(step, run.signal.aborted ? `Cancelled at ${clockWords(Date.now() / 1000).slice(0, 8)}; nothing was changed` : `It ended: no answer from tactiled web (${error.message})`); }
    clearInterval(ticking);
    until = null;
    showLeft();
    button.disabled = false;
    if (document.activeElement === cancel) button.focus();
    cancel.disabled = true;
  };
}

/** Hand on each line of an answer, which are JSON. A refusal is one line without an end. */
async function follow(response, take) {
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    const lines = (rest + (value ?? "")).split("\n");
    rest = done ? "" : lines.pop();
    for (const line of lines) if (line !== "") take(JSON.parse(line));
    if (done) return;
  }
}

// Guided tuning of the slip detector: the prompts of `tactiled tune`, one at a time, and its verdict.

import { put, row } from "./dom.js";
import { clockWords } from "./words.js";

const TICK_MS = 250;

/** Controls of a panel; `post(do, fields, signal)` asks the server, and `use(fields)` gives the proposed setting. */
export function guideTuning(panel, post, use) {
  const root = panel.root.querySelector(".tune"), at = (selector) => root.querySelector(selector);
  const start = at(".start"), cancel = at(".cancel"), step = at(".step"), left = at(".left"), said = at(".said"), verdict = at(".verdict");
  let run = null, until = null;

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

  function take(line) {
    if (line.left_s !== undefined) { countDown(line.left_s); return; }
    if (line.words !== undefined) {
      until = null;
      said.textContent += `${line.words}\n`;
      if (line.words !== "" && verdict.hidden && !step.dataset.reported) put(step, line.words);
      if (line.words.endsWith(" ...")) step.dataset.reported = true; // the report follows, as a whole
    }
    if (line.ok === true) showVerdict(line.found);
    if (line.ok === false) put(step, `It ended without a result: ${line.reason}`);
  }

  function showVerdict(found) {
    const { setting, is_accepted, friction, friction_log_sd } = found.proposed, of = found.settings[setting];
    const n = of.motion.incipient + of.motion.gross, held = of.quiet.incipient + of.quiet.gross;
    put(step, is_accepted ? `Proposed: ${setting}` : `Even ${setting} reports more than ${found.accepted_per_hour} slips an hour`);
    put(at(".how-sure"), `${count(n)} in ${found.motion.contact_s.toFixed(0)} s of motion, ${held} in ${found.quiet.contact_s.toFixed(0)} s of hold: at most ${rate(of.per_hour.high)} an hour (95 %). `
      + (of.per_hour.high > found.accepted_per_hour ? "Only a longer motion can show fewer. " : "")
      + (friction === null ? "Friction is known no better than before." : `Friction of this object: ${friction.toFixed(2)} (shear over load), ± ${Math.round(100 * friction_log_sd)} %.`));
    at("thead").replaceChildren(row("th", ["setting", "in hold", "in motion", "an hour, 95 %"]));
    at("tbody").replaceChildren(...Object.entries(found.settings).map(([name, { quiet, motion, per_hour }]) =>
      row("td", [name, quiet.incipient + quiet.gross, motion.incipient + motion.gross, `${rate(per_hour.low)} to ${rate(per_hour.high)}`])));
    put(at(".toml"), found.toml);
    put(at(".use"), `Use ${setting} now`);
    at(".use").onclick = () => use({ "grip.incipient_p": of.incipient_p, "grip.gross_p": of.gross_p });
    verdict.hidden = false;
  }

  start.onclick = async () => {
    run = new AbortController();
    verdict.hidden = true;
    delete step.dataset.reported;
    said.textContent = "";
    start.disabled = true; cancel.disabled = false;
    cancel.focus();
    put(step, "Starting\u2026");
    const ticking = setInterval(showLeft, TICK_MS);
    try { await follow(await post("tune", fields(), run.signal), take); }
    catch (error) { put(step, run.signal.aborted ? `Cancelled at ${clockWords(Date.now() / 1000).slice(0, 8)}; nothing was changed` : `It ended: no answer from tactiled web (${error.message})`); }
    clearInterval(ticking);
    until = null;
    showLeft();
    start.disabled = false;
    if (document.activeElement === cancel) start.focus();
    cancel.disabled = true;
  };
  cancel.onclick = () => run.abort();

  const fields = () => ({ array: panel.board.info?.array_id ?? "", quiet_s: Number(at(".quiet-s").value),
    motion_s: Number(at(".motion-s").value), reports_per_hour: Number(at(".reports").value) });
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

const count = (n) => `${n} slip${n === 1 ? "" : "s"} reported`;
const rate = (perHour) => (perHour >= 10 || perHour === 0 ? perHour.toFixed(0) : perHour.toPrecision(2));

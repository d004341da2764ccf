// Guided tuning of the slip detector: the prompts of `tactiled tune`, and its verdict.

import { put, row } from "./dom.js";
import { makeGuide } from "./guided.js";

/** Controls of a panel; `post(do, fields, signal)` asks the server, and `use(fields)` gives the proposed setting. */
export function guideTuning(panel, post, use) {
  const root = panel.root.querySelector(".tune"), at = (selector) => root.querySelector(selector);
  const start = at(".start"), verdict = at(".verdict"), run = makeGuide(root);

  function showVerdict(found) {
    const { setting, is_accepted, friction, friction_log_sd } = found.proposed, of = found.settings[setting];
    const what = panel.board.geometry?.unit === "N" ? "shear over load" : "shear over load, both as readings";
    const n = of.motion.incipient + of.motion.gross, held = of.quiet.incipient + of.quiet.gross;
    put(at(".step"), is_accepted ? `Proposed: ${setting}` : `Even ${setting} reports more than ${found.accepted_per_hour} slips an hour`);
    put(at(".how-sure"), `${count(n)} in ${found.motion.contact_s.toFixed(0)} s of motion, ${held} in ${found.quiet.contact_s.toFixed(0)} s of hold: at most ${rate(of.per_hour.high)} an hour (95 %). `
      + (of.per_hour.high > found.accepted_per_hour ? "Only a longer motion can show a lower rate. " : "")
      + (friction === null ? "The friction of this object is not known better than before." : `Friction of this object: ${friction.toFixed(2)} (${what}), ± ${Math.round(100 * friction_log_sd)} %.`));
    at("thead").replaceChildren(row("th", ["setting", "in hold", "in motion", "an hour, 95 %"]));
    at("tbody").replaceChildren(...Object.entries(found.settings).map(([name, { quiet, motion, per_hour }]) =>
      row("td", [name, quiet.incipient + quiet.gross, motion.incipient + motion.gross, `${rate(per_hour.low)} to ${rate(per_hour.high)}`])));
    put(at(".toml"), found.toml);
    put(at(".use"), `Use ${setting} now`);
    at(".use").onclick = () => use({ "grip.incipient_p": of.incipient_p, "grip.gross_p": of.gross_p });
    verdict.hidden = false;
  }

  const fields = () => ({ array: panel.board.info?.array_id ?? "", quiet_s: Number(at(".quiet-s").value),
    motion_s: Number(at(".motion-s").value), reports_per_hour: Number(at(".reports").value) });
  start.onclick = () => {
    verdict.hidden = true;
    return run(start, (signal) => post("tune", fields(), signal), showVerdict);
  };
}

const count = (n) => `${n} slip${n === 1 ? "" : "s"} reported`;
const rate = (perHour) => (perHour >= 10 || perHour === 0 ? perHour.toFixed(0) : perHour.toPrecision(2));

// Numbers and events in words.

import { way } from "./verdict.js";

export const UNKNOWN_SD = 1e8; // messages say 1e9 where a component is not known

export function ageWords(seconds) {
  if (seconds === null || !Number.isFinite(seconds)) return "–";
  const s = Math.max(0, seconds);
  if (s < 1) return `${Math.round(1000 * s)} ms`;
  if (s < 100) return `${s.toFixed(1)} s`;
  if (s < 6000) return `${Math.round(s / 60)} min`;
  return `${(s / 3600).toFixed(1)} h`;
}

/** Number with so many decimals; zero has no sign, and what is no number is a dash. */
export function fixed(value, places) {
  return Number.isFinite(value) ? value.toFixed(places).replace(/^-(?=[0.]+$)/, "") : "–";
}

/** Number with so many significant digits and no exponent. */
export function sig(value, digits = 3) {
  return value === 0 ? "0" : fixed(value, Number.isFinite(value) ? placesOf(value, digits) : 0);
}

/** Decimals of a number with so many significant digits, at most 6. */
export const placesOf = (value, digits) => Math.min(6, Math.max(0, digits - 1 - Math.floor(Math.log10(Math.abs(value)))));

/** Value and standard deviation, with the digits that the deviation allows. */
export function pm(value, sd, unit) {
  if (!(sd > 0)) return `${sig(value, 3)} ${unit}`;
  if (sd >= UNKNOWN_SD) return "not known";
  const power = Math.floor(Math.log10(sd));
  const places = Math.min(6, Math.max(0, (sd / 10 ** power < 2 ? 1 : 0) - power)); // one digit of the deviation, two below 2
  return `${fixed(value, places)} ± ${sd.toFixed(places)} ${unit}`;
}

export const bytesWords = (n) => (n < 1e6 ? `${(n / 1e3).toFixed(0)} kB` : n < 1e9 ? `${(n / 1e6).toFixed(1)} MB` : `${(n / 1e9).toFixed(2)} GB`);

export function clockWords(unix) {
  const date = new Date(unix * 1000);
  return `${date.toLocaleTimeString("en-GB")}.${String(date.getMilliseconds()).padStart(3, "0")}`;
}

export const REFUSALS = {
  "no-slip": "The slide ended before a window was full: slide for longer, or give the speed.",
  "too-few-periods": "The window holds too few periods of the ripple: slide further.",
  aliased: "The ripple is too fast for the scan rate: slide more slowly.",
  ambiguous: "Several gratings fit equally well: give the speed.",
  "uneven-channels": "The phases of the channels differ too much: give the speed.",
  "several-gratings": "The ripple comes from two gratings, or from a grating and a vibration: slide over one grating alone.",
  machine: "All channels swing at once, as with a motor or an arm: slide at another speed.",
  "low-snr": "No ripple exceeds the noise: the surface may be flat. Press harder.",
  saturated: "Too few channels can be read: press less.",
  stale: "The answer came too late: check the load of the host.",
};

/** Text of a mark in the stream of the daemon. */
export function markText(command) {
  try { return String(JSON.parse(command.arguments).text ?? ""); } catch { return ""; }
}

/** One line for an event: {kind, text}; kind colours it. The words are those of tactiled/events/words.py. */
export function eventWords(topic, data) {
  if (topic === "slip") {
    const why = data.suppressed ? `, suppressed: ${data.suppressed}` : data.valid ? "" : ", not valid";
    const kind = why ? "suppressed" : data.state === "end" ? "end" : data.kind;
    const lasted = data.detected - data.onset;
    if (data.state === "end") return { kind, text: `${data.kind} slip ended after ${lasted.toFixed(2)} s${why}` };
    const towards = way(data.direction_deg, data.direction_sd_deg);
    const there = towards && ` towards ${towards} (${Math.round(data.direction_deg)} ± ${Math.max(1, Math.round(data.direction_sd_deg))}°)`;
    const sure = why || `, p ${data.confidence.toFixed(2)}, latency ${Math.round(1000 * lasted)} ms (± ${Math.round(1000 * data.onset_sd_s)} ms)`;
    return { kind, text: `${data.kind} slip${there}${sure}` };
  }
  if (topic === "contact") return { kind: "contact", text: `contact ${data.previous} → ${data.state}` };
  if (topic === "texture") {
    const period = pm(data.period_mm, data.period_sd_mm, "mm");
    if (data.status === "ok") return { kind: "texture", text: `grooves ${period} at ${pm(data.angle_deg, data.angle_sd_deg, "").trim()}°` };
    if (data.status === "period-only") return { kind: "texture", text: `ripple ${period}, angle unknown` };
    return { kind: "refusal", text: `no groove estimate: ${data.status}` };
  }
  if (topic === "command") {
    const note = data.command === "mark" ? markText(data) : "";
    const text = note ? `mark: ${note}` : `${data.command} by ${data.who || "?"}`;
    return { kind: data.ok ? "command" : "refused", text: data.ok ? text : `${text} refused: ${data.reason}` };
  }
  if (topic === "mark") return { kind: "command", text: `${data.text}, kept in this page only` };
  if (topic === "gap") return { kind: "gap", text: `${data.words}` };
  return { kind: "notice", text: data.words || topic };
}

// The sentence above all numbers: what the contact does and what to do, then how surely.

const NEAR = 0.7;          // utilisation that `needed_load` of the grip messages aims at: above it, tighten
const LIKELY = 0.5;
const WAYS = ["+x", "+x +y", "+y", "−x +y", "−x", "−x −y", "−y", "+x −y"];

/** The way of the skin over the surface in words; "" where it is not known. */
export function way(deg, sd = 0) {
  return sd < 90 ? WAYS[((Math.round(deg / 45) % 8) + 8) % 8] : "";
}

/**
 * Verdict on the contact at instant `now`, from the newest messages of a board that is FRESH or LATE.
 * Returns {level, sentence, sure}; `level` is free, good, near, partial or gross and colours the sentence.
 * A recording asks for nothing: there, nobody can act any more.
 */
export function verdict(board, now, isRecorded = false) {
  const { slip } = board;
  const grip = board.current(board.grip);
  const contact = board.touch?.state ?? board.status?.contact ?? "none";
  const state = slip === null ? contact : slip.kind === "gross" ? "sliding" : "shearing";
  const sure = chances(grip, state, slip);
  const todo = isRecorded ? "" : ": tighten";
  if (state === "sliding" || state === "shearing") {
    const towards = slip === null ? "" : way(slip.direction_deg, slip.direction_sd_deg);
    const words = (state === "sliding" ? "Slipping" : "Beginning to slip") + (towards && ` towards ${towards}`) + (slip === null ? "" : ` for ${duration(now - slip.onset)}`);
    if (slip?.suppressed) return { level: "good", sentence: `${words}, as announced (${slip.suppressed})`, sure };
    if (slip !== null && !slip.valid && !grip?.valid) return { level: "near", sentence: `${words}: do not act on it`, sure: "The readings were late or incomplete." };
    return { level: state === "sliding" ? "gross" : "partial", sentence: words + todo, sure };
  }
  if (state === "none") return { level: "free", sentence: "Nothing touches the skin", sure };
  if (state === "unknown") return { level: "near", sentence: "Touching, may hold or slip" + (isRecorded ? "" : ": lift once"), sure: sure || "The beginning of this contact was not seen." };
  if (grip?.valid && (grip.utilisation > NEAR || grip.p_gross_100ms > LIKELY)) return { level: "near", sentence: "Holding near the friction limit" + todo, sure };
  return { level: "good", sentence: state === "loading" ? "Being pressed" : "Holding", sure };
}

/** How surely, in one line of at most 60 characters. */
function chances(grip, state, slip) {
  if (state === "none") return "";
  if (grip === null || grip.state === "none") return slip === null ? "" : `${percent(slip.confidence)} sure`;
  if (grip.state === "unknown") return "";
  const isNewer = slip !== null && grip.timestamp < slip.detected; // the slip came ahead of the margins of its scan
  if (state === "sliding") return `${percent(isNewer ? slip.confidence : grip.p_sliding)} sure that all of the contact slides`;
  if (state === "shearing" && slip !== null) return `${percent(slip.confidence)} sure that a part of the contact slips`;
  if (grip.p_gross_100ms > LIKELY) return `${percent(grip.p_gross_100ms)} sure that it slips within 0.1 s`;
  return `${percent(grip.utilisation)} of the friction limit in use`;
}

export const percent = (share) => `${Math.round(100 * share)} %`;

function duration(seconds) {
  const s = Math.max(0, seconds);
  return s < 10 ? `${s.toFixed(1)}\u00a0s` : s < 100 ? `${Math.round(s)}\u00a0s` : `${Math.round(s / 60)}\u00a0min`; // a line does not end before the unit
}

// The lamp: how old the newest data are, by the instants in the messages and never by arrival at the page alone.

const SILENT_S = 0.3;      // three statuses missing; protocols/events.md: after this, trust nothing
const LATE_S = 0.22;       // 100 ms (samples.late_after_s) + one frame of the server
const PERIODS = 3;         // slow boards: so many scan periods are not late

const SETTLED_S = 1;       // so long without a worse state before a better one is shown
const RANKS = { fresh: 0, late: 1, stale: 2, none: 2 };

/** Shows a worse state at once and a better one when it has lasted: a lamp that flickers cannot be read. */
export class SteadyLamp {
  constructor() { this.shown = null; this.worseAt = -Infinity; }

  /** The lamp to show at `perf` (monotonic seconds), given that of this instant. */
  follow(lamp, perf) {
    if (this.shown === null || RANKS[lamp.state] >= RANKS[this.shown.state]) { this.shown = lamp; this.worseAt = perf; }
    else if (perf - this.worseAt > SETTLED_S) { this.shown = lamp; this.worseAt = perf; }
    return { ...this.shown, age: lamp.age };
  }
}

/**
 * State of a board at server instant `now` (epoch seconds; null before the first frame).
 * Returns {state, word, age (seconds or null), words}.
 */
export function freshness(board, now, connected) {
  const status = board.status;
  if (now === null || status === null) {
    const words = connected ? "No status from the daemon yet: is tactiled run running?" : "No connection to tactiled web: trying again.";
    return { state: "stale", word: "STALE", age: null, words };
  }
  const silent = now - status.timestamp;
  const scanAge = board.newestScan === null ? status.age_s + silent : now - board.newestScan.timestamp;
  const behind = -silent;
  if (!connected) return { state: "stale", word: "STALE", age: scanAge, words: "No connection to tactiled web: trying again." };
  if (silent > SILENT_S) {
    return { state: "stale", word: "STALE", age: scanAge,
      words: `No status for ${silent.toFixed(1)} s: is tactiled running, and does this browser keep up?` };
  }
  if (behind > 1) return { state: "stale", word: "STALE", age: null, words: "Messages have times in the future: compare the clocks of the hosts." };
  if (status.state === "no-device") return { state: "none", word: "NO BOARD", age: scanAge, words: (/no such port/.test(status.reason) ? "Is the board plugged in? " : "") + sentence(status.reason) };
  if (!status.valid) return { state: "stale", word: "STALE", age: scanAge, words: sentence(`${status.state}: ${status.reason}`) };
  const period = status.rate_hz > 0 ? 1 / status.rate_hz : 0;
  const late = Math.max(LATE_S, PERIODS * period);
  if (scanAge > Math.max(SILENT_S, 2 * late)) return { state: "stale", word: "STALE", age: scanAge, words: "No scan reaches this page." };
  if (scanAge > late || (board.newestScan !== null && board.newestScan.late)) {
    return { state: "late", word: "LATE", age: scanAge, words: "Scans come too late for a controller: check the load of the host and the adapter." };
  }
  return { state: "fresh", word: "FRESH", age: scanAge, words: sentence(status.warning) };
}

/** Text as a sentence: a capital first, a stop last. */
export function sentence(text) {
  const clean = (text || "").trim();
  if (!clean) return "";
  return clean[0].toUpperCase() + clean.slice(1) + (/[.?!]$/.test(clean) ? "" : ".");
}

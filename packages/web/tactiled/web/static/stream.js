// Connection to the server: frames as they come, a new attempt after each loss, and the server's clocks.

import { unpack } from "./unpack.js";

const RETRY_FIRST_MS = 250;
const RETRY_LAST_MS = 2000;
const FRAMES_PER_ANSWER = 2; // an answer to each would cost the server a twentieth more
const STOOD_S = 0.5; // between two frames; by less, a clock is slewed, or read a little later than the other one
const RATES_DIFFER = 5e-4; // largest difference in rate of two hosts' clocks: five times that of a bad crystal

/** The server's wall clock as it is now, with the time that frames spent on their way. */
export class ServerClock {
  constructor() { this.reset(); }

  reset() { this.least = null; this.leastAt = 0; this.frame = null; }

  /** Take the clocks of a frame; `perf` is this browser's monotonic clock in seconds when the frame arrived. */
  observe(now, mono, perf) {
    const lead = perf - mono, { frame } = this;
    // The monotonic clock of a host stands still while it sleeps, and its wall clock does not. A step of the wall clock leaves the lead as it was.
    const stood = frame === null ? 0 : (now - mono) - (frame.now - frame.mono);
    if (stood > STOOD_S && lead > this.least) { this.least = Math.min(lead, this.least + stood); this.leastAt = perf; }
    const allowed = this.least === null ? Infinity : this.least + RATES_DIFFER * (perf - this.leastAt);
    if (lead < allowed) { this.least = lead; this.leastAt = perf; }
    this.frame = { now, mono };
  }

  /** Epoch seconds of the server at the browser's monotonic instant `perf`; null before the first frame. */
  at(perf) {
    return this.frame === null ? null : this.frame.now + (perf - this.least - this.frame.mono);
  }
}

export const perfSeconds = () => performance.now() / 1000;

/** Keep a WebSocket open; `onFrame(frame)` for each frame, `onState(open)` for each change. Loads the page anew where the server has another `version` of it. */
export function connect(clock, version, onFrame, onState) {
  let wait = RETRY_FIRST_MS, taken = 0;
  const open = () => {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { clock.reset(); wait = RETRY_FIRST_MS; taken = -1; onState(true); }; // the history is not counted
    socket.onmessage = (message) => {
      taken += 1;
      if (taken % FRAMES_PER_ANSWER === 0) socket.send(`${taken}`); // ready for others
      const frame = unpack(message.data);
      if (frame.mono !== undefined) clock.observe(frame.now, frame.mono, perfSeconds());
      onFrame(frame);
    };
    socket.onclose = () => {
      onState(false);
      setTimeout(retry, wait);
      wait = Math.min(2 * wait, RETRY_LAST_MS);
    };
  };
  const retry = async () => {
    try {
      const answer = await fetch("/api/session"), page = answer.ok ? (await answer.json()).page : version; // a proxy may answer
      if (typeof page === "string" && page !== version) { location.reload(); return; }
    } catch { /* no server yet */ }
    open();
  };
  open();
}

// A recording in the live view: fetches stretches ahead of the position, and feeds them as time goes by.

import { SPAN_S } from "./board.js";
import { recordingQuery } from "./recordings.js";
import { colour, fit, onTheme } from "./theme.js";

const STRETCH_S = 5;
const AHEAD_S = 12;       // more than a stretch at ten times the speed

export class Player {
  constructor(recording, feed, rewind) {
    this.start = recording.start;
    this.length = recording.end - recording.start;
    this.name = recording.name;
    this.events = recording.events;
    this.feed = feed;        // called with messages in order of time
    this.rewind = rewind;
    this.position = 0;
    this.playing = false;
    this.speed = 1;
    this.queue = [];
    this.fetched = 0;
    this.waiting = false;
    this.generation = 0;
    this.shown = 0;          // position up to which messages were fed
    this._controls();
  }

  _controls() {
    const get = (id) => document.getElementById(id);
    this.at = { bar: get("replay"), play: get("play"), position: get("position"), clock: get("clock"), speed: get("speed"), marks: get("marks") };
    this.at.bar.hidden = false;
    this.at.position.max = this.length.toFixed(2);
    this.at.play.onclick = () => this.toggle();
    get("back").onclick = () => this.seek(this.position - 1);
    get("on").onclick = () => this.seek(this.position + 1);
    this.at.position.oninput = () => this.seek(Number(this.at.position.value));
    this.at.speed.onchange = () => { this.speed = Number(this.at.speed.value); };
    get("copy").onclick = () => this.copy();
    document.addEventListener("keydown", (event) => this._key(event));
    new ResizeObserver(() => this._marks()).observe(this.at.marks);
    onTheme(() => this._marks());
  }

  _key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const tag = event.target.tagName;
    if (tag === "SELECT" || event.target.matches(".list, .scroll") || (tag === "BUTTON" && event.key === " ") || (tag === "INPUT" && event.target !== this.at.position)) return;
    const step = event.shiftKey ? 0.1 : 1;
    const act = { " ": () => this.toggle(), ArrowLeft: () => this.seek(this.position - step), ArrowRight: () => this.seek(this.position + step),
      ArrowUp: () => this._faster(1), ArrowDown: () => this._faster(-1), Home: () => this.seek(0), End: () => this.seek(this.length), c: () => this.copy(), C: () => this.copy() }[event.key];
    if (act === undefined) return;
    event.preventDefault();
    act();
  }

  _faster(step) {
    const options = this.at.speed.options;
    this.at.speed.selectedIndex = Math.max(0, Math.min(options.length - 1, this.at.speed.selectedIndex + step));
    this.speed = Number(this.at.speed.value);
  }

  toggle() {
    if (!this.playing && this.position >= this.length) this.seek(0);
    this.playing = !this.playing;
    this.at.play.textContent = this.playing ? "❚❚" : "▶";
    this.at.play.setAttribute("aria-label", this.playing ? "Pause" : "Play");
  }

  async copy() {
    const link = `${location.origin}${location.pathname}${location.search}#at=${this.position.toFixed(3)}`;
    history.replaceState(null, "", link);
    const button = document.getElementById("copy");
    try { await navigator.clipboard.writeText(link); button.textContent = "Copied"; } catch { button.textContent = "In the address bar"; }
    setTimeout(() => { button.textContent = "Copy link"; }, 1500);
  }

  /** Go to an instant: what the timeline shows before it is fetched thinned, the last seconds in full. */
  async seek(position) {
    const generation = this.generation += 1;
    this.position = Math.max(0, Math.min(this.length, Number.isFinite(position) ? position : 0));
    this._show();
    const to = this.position, full = Math.max(0, to - 6);
    this.waiting = true;
    const parts = [];
    for (let from = Math.max(0, to - SPAN_S); from < full; from += 30) parts.push(this._stretch(from, Math.min(full, from + 30), true));
    parts.push(this._stretch(full, to + 0.001, false));
    parts.push(this._stretch(0, Math.min(2, this.length), true)); // who the board is
    let found;
    try { found = await Promise.all(parts); }
    catch { // the server is away
      setTimeout(() => { if (generation === this.generation) this.seek(position); }, 1000);
      return;
    }
    if (generation !== this.generation) return; // a newer seek is under way
    this.rewind();
    const first = found.pop();
    this.feed(first.filter(([, topic]) => topic === "geometry" || topic === "info"));
    for (const messages of found) this.feed(messages);
    this.queue = [];
    this.fetched = to + 0.001;
    this.shown = to;
    this.waiting = false;
  }

  async _stretch(from, to, thin) {
    const response = await fetch(`/api/replay?from=${from}&to=${to}&thin=${thin ? 1 : 0}&${recordingQuery()}`);
    if (!response.ok) throw new Error(`HTTP ${response.status}`);
    return (await response.json()).m;
  }

  /** Go on by `elapsed` seconds of the browser; returns the epoch instant to show. */
  tick(elapsed) {
    if (this.playing && !this.waiting) {
      // Not beyond what was fetched: it would be passed over, and the end reached without it.
      this.position = Math.min(this.length, this.fetched, this.position + elapsed * this.speed);
      let n = 0;
      while (n < this.queue.length && instant(this.queue[n]) <= this.start + this.position) n += 1;
      if (n) this.feed(this.queue.splice(0, n));
      this.shown = this.position;
      if (this.position >= this.length) this.toggle();
      this._show();
    }
    this._fetchAhead();
    return this.start + this.shown; // while a stretch is being fetched, the instant of what is drawn
  }

  async _fetchAhead() {
    if (this.waiting || this.fetching || this.fetched > this.length || this.fetched > this.position + AHEAD_S) return;
    this.fetching = true;
    const generation = this.generation, from = this.fetched, to = from + STRETCH_S;
    try {
      const messages = await this._stretch(from, to, false);
      if (generation === this.generation) { this.queue.push(...messages.filter(([, topic]) => topic !== "geometry")); this.fetched = to; }
    } catch { /* the server is away: tried again with the next frame */ }
    this.fetching = false;
  }

  _show() {
    this.at.position.value = this.position;
    this.at.clock.textContent = `${this.position.toFixed(2)} / ${this.length.toFixed(1)} s`;
  }

  /** Slips and groove answers of the whole recording, behind the slider. */
  _marks() {
    const { context: c, width, height } = fit(this.at.marks);
    c.clearRect(0, 0, width, height);
    const x = (at) => width * at / this.length;
    for (const event of this.events) {
      const { topic, data } = event;
      if (topic === "contact" || topic === "slip" && data.state === "end") continue;
      c.fillStyle = colour(topic === "texture" ? "texture" : topic === "command" ? "contact" : data.suppressed || !data.valid ? "muted" : data.kind === "gross" ? "slip" : "incipient");
      c.fillRect(x(event.at), topic === "texture" ? height / 2 : 0, 2, height / 2);
    }
  }
}

const instant = ([, , data]) => data.timestamp;

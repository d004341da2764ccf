// What is known of one board: newest messages, the last minute for the timeline, the last seconds of readings.

import { ageWords, markText, UNKNOWN_SD } from "./words.js";

export const SPAN_S = 60;        // that a page which opens gets of the past
const KEEP_S = 600;              // that it keeps
const UNCALIBRATED = ["nominal", "none"]; // values of `calibration` with which no force is known in newtons
const RING_S = 11;               // readings for scope and faults of channels
const POINT_S = 0.095;           // interval of points on the timeline, 6000 of them: one for each frame, as of forces, and of the history
const EVENTS = 400;
const HEALTH_SCANS = 100;
const GAP_S = 0.2;               // scans of the history are 0.1 s and a period apart: more is a time without scans
const GAP_PERIODS = 2.5;         // slow boards
const FORCE_COMES_S = 5;         // so long curves in newtons wait for the force of a scan: after a gap it comes later, and a server that was held up has the newest alone
const FORCE_SENT_S = 1;          // of scans with which a daemon has sent a force, if it states any
const OVERTAKEN_S = 1;           // by which a message of another topic, made later, may come before a status
const SET_BACK_S = 1;            // of the clock; by less, it costs a few scans
const CURRENT_S = 0.3;           // messages for each scan that are older than the newest scan by this have ended
const CURRENT_PERIODS = 3;       // slow boards

export class BoardModel {
  constructor(source, name) {
    this.source = source;
    this.name = name;
    this.info = this.geometry = this.status = this.recording = null;
    this.touch = null;       // newest contact message
    this.grip = this.force = null;
    this.settings = null;    // of the daemon, where this page may give commands
    this.unit = "";          // of the points
    this.slip = null;        // newest slip message of a slip that goes on
    this.texture = null;     // newest texture message of this slide
    this.newestScan = null;
    this.scans = [];         // of the last RING_S
    this.points = { t: [], load: [], shear: [], risk: [], use: [], sliding: [], rate: [], volts: [] };
    this.marks = [];         // {at, text, here}; here: this page alone has it
    this.events = [];        // newest last: {at, topic, data}
    this.bands = [];         // contact states: {from, state}
    this.slips = [];         // {from, to, kind, sd, suppressed, direction}
    this.gaps = [];          // {from, to, words}: times without scans, over which nothing is drawn
    this.seen = new Set();
    this.knownUntil = Infinity; // instant after which nothing is known, where the data are stale
    this.changed = 0;        // counts messages, so that views know when to draw
    this.eventCount = 0;
    this.health = [];        // for each channel: "", "dead", "noisy" or "stuck"
    this.zero = [];          // readings without a load; empty while they are not known
  }

  /** Forget what belongs to instants after `until` or before the window; used by a seek in a recording. */
  rewind() {
    const kept = { info: this.info, geometry: this.geometry, zero: this.zero, settings: this.settings, marks: this.marks.filter((mark) => mark.here) };
    Object.assign(this, new BoardModel(this.source, this.name), kept);
    for (const mark of this.marks) this._list(mark.at, "mark", mark);
  }

  /** Take a message. Returns the topic where it was news, for announcements; else null. */
  take(topic, data, recovered) {
    this.changed += 1;
    switch (topic) {
      case "info": this.info = data; this.zero = data.zero; return null;
      case "geometry": this._geometry(data); return null;
      case "status": this._dropOtherRuns(data.run); this._dropEnded(data); this.status = data; if (data.contact !== undefined && this.touch === null) this._band(data.timestamp, data.contact); return null;
      case "recording": this.recording = data; return null;
      case "settings": this.settings = data; return null;
      case "scan": if (!recovered) this._scan(data); return null;
      case "grip": if (!recovered) this.grip = data; return null;
      case "force": if (!recovered) this.force = data; return null;
      default: return this._event(topic, data);
    }
  }

  _geometry(geometry) {
    this.geometry = geometry;
    this.scans = [];
    this.health = geometry.names.map(() => "");
  }

  /** Forget what another run of the daemon said of now: its slips and contacts never end. */
  _dropOtherRuns(run) {
    const old = (message) => message !== null && message.run !== run;
    const open = this.slips[this.slips.length - 1];
    if (old(this.slip) && open !== undefined && open.to === null) open.to = Math.max(open.from, this.newestScan?.timestamp ?? 0);
    for (const name of ["touch", "slip", "texture", "grip", "force"]) if (old(this[name])) this[name] = null;
  }

  /** Forget a slip and a contact that a later status does not have: their end was lost. In a frame, a status comes after younger events. */
  _dropEnded(status) {
    const before = (at) => at < status.timestamp - OVERTAKEN_S;
    if (this.slip !== null && status.slipping === false && before(this.slip.detected)) this._slip({ state: "end", timestamp: status.timestamp });
    if (this.touch !== null && status.contact !== undefined && this.touch.state !== status.contact && before(this.touch.timestamp)) this.touch = null;
    if (this.texture !== null && status.contact === "none" && before(this.texture.timestamp)) this.texture = null;
  }

  /** A message that comes with each scan; null where it is not of the newest ones: its detector has ended. */
  current(message) {
    if (message === null || this.newestScan === null) return null;
    return Math.abs(this.newestScan.timestamp - message.timestamp) > Math.max(CURRENT_S, CURRENT_PERIODS * this._period()) ? null : message;
  }

  /** Seconds from one scan to the next, as measured or else as configured; 0 where unknown. */
  _period() {
    const rate = this.status?.rate_hz || this.info?.rate_hz || 0;
    return rate > 0 ? 1 / rate : 0;
  }

  _scan(scan) {
    const before = this.newestScan;
    if (before !== null && before.run === scan.run && scan.timestamp <= before.timestamp) {
      if (!(scan.seq > before.seq && scan.timestamp < before.timestamp - SET_BACK_S)) return;
      this.rewind(); // the clock of the host was set back: what lies ahead of it now would hide all that comes
    }
    if (before !== null) {
      const why = before.run !== scan.run ? "new run of the daemon" : scan.index <= before.index ? "the board started anew" : "";
      if (why || scan.timestamp - before.timestamp > Math.max(GAP_S, GAP_PERIODS * this._period())) this._gap(before.timestamp, scan.timestamp, why);
    }
    this.newestScan = scan;
    this.scans.push(scan);
    const oldest = scan.timestamp - RING_S;
    if (this.scans.length > 64 && this.scans[0].timestamp < oldest - 1) this.scans = this.scans.filter((s) => s.timestamp >= oldest);
    if (this.geometry === null) return;
    const t = this.points.t;
    if (t.length && scan.timestamp - t[t.length - 1] < POINT_S) return;
    const now = this.loads();
    if (now.unit !== "N" && this._awaitsForce(scan.timestamp)) return;
    if (now.unit !== this.unit) { this.unit = now.unit; for (const key of Object.keys(this.points)) this.points[key] = []; }
    this._point(scan, now.load, now.shear);
  }

  /** Mark an instant in this page. */
  mark(at) {
    const mark = { at, text: `mark ${1 + this.marks.filter((other) => other.here).length}`, here: true };
    this.marks.push(mark);
    this._list(at, "mark", mark);
  }

  /** Whether something touches the skin, as the daemon says. */
  isTouched() { return (this.touch?.state ?? this.status?.contact ?? "none") !== "none"; }

  /** The newest force message, where it states newtons of a calibration; else null. */
  calibrated() {
    const force = this.current(this.force);
    return force === null || UNCALIBRATED.includes(force.calibration) ? null : force;
  }

  /**
   * Load and shear now, in newtons where the array is calibrated, else as sums of readings.
   * The shear points the way in which the skin is pushed: the object pushes it the other way.
   */
  loads() {
    const force = this.calibrated();
    if (force !== null) {
      const known = force.fx_sd_n < UNKNOWN_SD && force.fy_sd_n < UNKNOWN_SD;
      return { unit: "N", load: force.fz_sd_n >= UNKNOWN_SD ? null : force.fz_n, loadSd: force.fz_sd_n, shear: known ? Math.hypot(force.fx_n, force.fy_n) : null,
        shearSd: Math.max(force.fx_sd_n, force.fy_sd_n), deg: degrees(-force.fx_n, -force.fy_n), force };
    }
    if (this.newestScan.volts.length !== this.zero.length) return { unit: this.geometry.unit, load: null, loadSd: 0, shear: null, shearSd: 0, deg: 0, force: null };
    const felt = this.felt(this.newestScan), x = sum(felt.x), y = sum(felt.y);
    return { unit: this.geometry.unit, load: sum(felt.load), loadSd: 0, shear: this.geometry.has_shear ? Math.hypot(x, y) : null, shearSd: 0, deg: degrees(x, y), force: null };
  }

  /** Whether the curves are in newtons, and a force for them may come yet. */
  _awaitsForce(at) {
    const { force } = this, names = force !== null && !UNCALIBRATED.includes(force.calibration);
    if (this.unit !== "N" || (force !== null && !names) || (force === null && this._statesNoForce())) return false;
    return at - Math.max(this.gaps.at(-1)?.to ?? -Infinity, names ? force.timestamp : -Infinity) < FORCE_COMES_S;
  }

  /** Whether the daemon says that it has sent scans of this run and no force. */
  _statesNoForce() {
    const { status } = this, sent = status?.run === this.newestScan.run ? status.sent : undefined;
    return sent?.force === 0 && sent.scan > FORCE_SENT_S * (status.rate_hz || this.info?.rate_hz || 0);
  }

  _point(scan, load, shear) {
    const p = this.points, t = scan.timestamp;
    const fresh = this.grip !== null && Math.abs(this.grip.timestamp - t) < 0.2 && this.grip.state !== "none";
    p.t.push(t); p.load.push(load); p.shear.push(shear);
    p.risk.push(fresh ? this.grip.p_gross_100ms : null);
    p.use.push(fresh ? this.grip.utilisation : null);
    p.sliding.push(fresh ? this.grip.p_sliding : null);
    p.rate.push(this.status?.rate_hz ?? null);
    p.volts.push(Float32Array.from(scan.volts, (_, c) => this.relative(scan, c) ?? NaN));
    if (p.t[0] < t - KEEP_S - 5) {
      let n = 0;
      while (p.t[n] < t - KEEP_S) n += 1;
      for (const key of Object.keys(p)) p[key].splice(0, n);
    }
  }

  /** Break all curves and bands between two scans; `why` is set where the second one began anew. */
  _gap(from, to, why) {
    const words = [why, `no scans for ${ageWords(to - from)}`].filter(Boolean).join(", ");
    this.gaps.push({ from, to, words });
    if (this.gaps.length > 100) this.gaps.shift();
    const p = this.points, last = p.t[p.t.length - 1];
    if (last !== undefined && to > last) {
      p.t.push((last + to) / 2);
      for (const key of Object.keys(p)) if (key !== "t") p[key].push(null);
    }
    const i = this.bands.findLastIndex((band) => band.from <= from); // the status of a new run comes before its scans
    if (i >= 0 && this.bands[i].state !== "none") {
      const after = why || i + 1 < this.bands.length ? [] : [{ from: to, state: this.bands[i].state, assumed: true }]; // the daemon has not said that it ended
      this.bands.splice(i + 1, 0, { from, state: "none" }, ...after);
    }
    this._list(to, "gap", { words });
  }

  _event(topic, data) {
    const key = `${data.run}/${topic}/${data.seq}`;
    if (data.seq !== undefined) {
      if (this.seen.has(key)) return null;
      this.seen.add(key);
      if (this.seen.size > 4 * EVENTS) this.seen = new Set([...this.seen].slice(-2 * EVENTS));
    }
    const at = topic === "slip" ? (data.state === "end" ? data.timestamp : data.detected) : data.timestamp ?? this.newestScan?.timestamp ?? 0;
    if (topic === "slip") this._slip(data);
    if (topic === "contact") {
      this.touch = data;
      this._band(data.timestamp, data.state);
      if (data.state === "none") { this.texture = null; this.grip = null; }
    }
    if (topic === "texture") this.texture = data;
    if (topic === "command" && data.command === "mark" && data.ok) this.marks.push({ at, text: markText(data), here: false });
    this._list(at, topic, data);
    return topic;
  }

  _list(at, topic, data) {
    this.eventCount += 1;
    const last = this.events[this.events.length - 1];
    if (topic === "texture" && last !== undefined && last.topic === topic && last.data.status === data.status) {
      Object.assign(last, { at, data, count: last.count + 1 }); // an estimate that is made better is one event
      return;
    }
    this.events.push({ at, topic, data, from: at, count: 1 });
    if (this.events.length > 1 && this.events[this.events.length - 2].at > at) this.events.sort((a, b) => a.at - b.at);
    if (this.events.length > EVENTS) this.events.shift();
  }

  _band(from, state) {
    if (this.bands.at(-1)?.assumed && from < this.bands.at(-1).from) this.bands.pop(); // said after the first scan behind the gap
    const last = this.bands.at(-1);
    if (last !== undefined && last.from > from) return;
    if (last === undefined || last.state !== state) this.bands.push({ from, state });
    if (this.bands.length > 300) this.bands.shift();
  }

  _slip(data) {
    const open = this.slips[this.slips.length - 1];
    if (data.state === "end") {
      if (open !== undefined && open.to === null) open.to = data.timestamp;
      this.slip = null;
      return;
    }
    if (open !== undefined && open.to === null) open.to = Math.max(open.from, data.onset);
    if (this.slip === null) this.texture = null; // a new slide: what was found before belongs to the last one
    this.slips.push({ from: data.onset, to: null, kind: data.kind, sd: data.onset_sd_s, detected: data.detected,
      suppressed: Boolean(data.suppressed) || !data.valid, direction: data.direction_deg });
    if (this.slips.length > 200) this.slips.shift();
    this.slip = data;
  }

  /** Reading of a channel less its zero; null where it has none. */
  relative(scan, c) {
    const v = scan.valid[c] ? scan.volts[c] - this.zero[c] : NaN;
    return Number.isFinite(v) ? v : null;
  }

  /** Load and shear of each taxel from a scan, relative to the zero. */
  felt(scan) {
    const g = this.geometry;
    const value = (pairs) => {
      let total = 0;
      for (const [c, w] of pairs) total += w * this.relative(scan, c);
      return total;
    };
    return { load: g.pressure.map(value), x: g.shear_x.map(value), y: g.shear_y.map(value) };
  }

  /** Judge the channels from the newest scans: invalid, far noisier than the others, or without any noise. */
  judgeChannels() {
    const scans = this.scans.slice(-HEALTH_SCANS);
    const n = this.health.length;
    if (scans.length < HEALTH_SCANS / 2 || n === 0) return;
    const middle = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];
    // Second differences: what a load does is nearly a straight line from scan to scan, but for a few bends, which medians leave out.
    const bends = (k) => scans.slice(2).map(({ volts }, i) => Math.abs(volts[k] - 2 * scans[i + 1].volts[k] + scans[i].volts[k]));
    const each = this.health.map((_, k) => bends(k)), noise = each.map(middle), median = middle(noise);
    const newest = scans[scans.length - 1];
    const isStuck = (c) => each[c].every((bend) => bend === 0);
    this.health = noise.map((s, c) => (!newest.valid[c] ? "dead" : !(median > 0) ? "" : s > 8 * median ? "noisy" : isStuck(c) ? "stuck" : ""));
  }
}

const degrees = (x, y) => Math.atan2(y, x) * 180 / Math.PI;

export const sum = (values) => values.reduce((a, b) => a + b, 0);

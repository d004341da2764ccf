// One board on the page: verdict, skin, numbers, timeline, events, channels, strip.

import { drawBar } from "./bar.js";
import { showSettings } from "./commands.js";
import { channelCurve, CurveChooser, valueWords } from "./curves.js";
import { announce, el, facts, fill, put, row } from "./dom.js";
import { freshness, SteadyLamp } from "./freshness.js";
import { historyControls } from "./history.js";
import { Scope, Timeline } from "./plots.js";
import { SkinPicture } from "./skin.js";
import { ageWords, bytesWords, clockWords, eventWords, fixed, placesOf, pm, REFUSALS, sig } from "./words.js";
import { percent, verdict, way } from "./verdict.js";

const PICTURE_S = 0.08;   // skin: with each frame of the server, which come every 120 ms and now and then sooner
const NUMBERS_S = 0.18;   // numbers and timeline, with every second frame: faster cannot be read, and is two pixels of a minute
const SLOW_S = 0.5;       // scope, labels
const LISTED = 60;
const RETRY_S = 1;        // after a drawing that failed
const LEAST = 0.03;       // of a full arrow on every taxel, or newtons: a shear below has no direction
const NONE = "–";

export class BoardPanel {
  constructor(board, parent, endpoint) {
    this.board = board;
    this.endpoint = endpoint; // where several are shown: two boards may have one serial number
    const root = document.getElementById("board-template").content.firstElementChild.cloneNode(true);
    this.root = root;
    parent.append(root);
    const find = (selector) => root.querySelector(selector);
    this.at = { lamp: find(".lamp"), word: find(".lamp .word"), age: find(".lamp .age"), advice: find(".advice"), sure: find(".sure"), name: find(".who .name"), what: find(".who .what"),
      range: find(".range"), loads: find(".loads"), calibration: find(".calibration"), used: find(".used"), bar: find(".bar"), margin: find(".margin"),
      texture: find(".texture"), list: find(".events .list"), strip: find(".strip"), chosen: find(".chosen"), readings: find(".readings"),
      scope: find(".scope"), readout: find(".readout") };
    this.tab = null;         // button that chooses this board, where there are several
    this.steady = new SteadyLamp();
    this.canvas = find("canvas.array");
    this.skin = new SkinPicture(this.canvas, find(".legend"));
    this.skin.onChoose = () => this._chooseChannels();
    this.timeline = new Timeline(find(".timeline .plot"));
    this.timeline.onHover = (i) => { this.hovered = i; };
    this.hovered = null;
    this.chooser = new CurveChooser(find(".curves"), find(".keys"), (curves) => this.timeline.choose(curves));
    this.give = null;        // gives a command to the daemon, where this page may
    historyControls(find, this);
    this.scope = new Scope(find(".scope .plot"));
    this.due = { picture: 0, numbers: 0, slow: 0 };
    this.drawn = { changed: -1, state: "", events: -1 };
    this.retry = 0;
    this.visible = new WeakMap();
    const watcher = new IntersectionObserver((entries) => { for (const e of entries) this.visible.set(e.target, e.isIntersecting); });
    for (const place of [this.at.scope, this.canvas, find(".timeline")]) watcher.observe(place);
    this.timelinePlace = find(".timeline");
  }

  /** Draw at server instant `now`; `replay` is {origin} for a recording, else null. */
  draw(now, connected, replay) {
    const board = this.board, perf = performance.now() / 1000;
    if (perf < this.retry) return;
    const lamp = replay === null ? this.steady.follow(freshness(board, now, connected), perf) : recorded(board, now, replay.words);
    this.lamp = lamp;
    if (this.root.hidden) { this._judge(lamp, now); return; }
    const changed = lamp.state !== this.drawn.state || lamp.shows !== this.drawn.shows;
    if (changed) this._lampChanged(lamp);
    if (this._hasEvent()) { // in words at once; the canvases, which take longer to paint, follow with the next frame of the screen
      this._texts(lamp, now);
      this.due.picture = this.due.numbers = 0;
      return;
    }
    if (changed || perf >= this.due.picture) {
      this.due.picture = perf + PICTURE_S;
      if (this.visible.get(this.canvas) !== false && (changed || board.changed !== this.drawn.changed)) this.skin.draw(board, lamp.shows ?? lamp.state);
      this.drawn.changed = board.changed;
    }
    if (changed || perf >= this.due.numbers) {
      this.due.numbers = perf + NUMBERS_S;
      this._texts(lamp, now);
      if (now !== null) this._timeline(lamp, now, replay === null ? 0 : replay.origin);
    }
    if (perf >= this.due.slow && now !== null) { this.due.slow = perf + SLOW_S; this._slow(now); }
  }

  /** Whether a picture at this instant would show something new. */
  isDue(perf) { return !this.root.hidden && (perf >= this.due.picture || this._hasEvent()); }

  _hasEvent() { return this.board.eventCount !== this.drawn.events; }

  _timeline(lamp, now, origin) {
    const { board } = this;
    board.knownUntil = lamp.state === "stale" || lamp.state === "none" ? Math.max(board.newestScan?.timestamp ?? 0, board.points.t.at(-1) ?? 0) : now;
    if (this.visible.get(this.timelinePlace) !== false) this.timeline.draw(board, now, this.skin.full, origin);
  }

  /** A message or drawing failed: what is shown may be old, so it is grey. Tried again after a second. */
  fail(error) {
    console.error(error);
    this.retry = performance.now() / 1000 + RETRY_S;
    const words = `A message of this board cannot be shown (${error.message}): are page and daemon of one version?`;
    this.drawn.state = "failed";
    this.at.lamp.dataset.state = this.root.dataset.state = "stale";
    put(this.at.word, "STALE");
    put(this.at.age, ageWords(null));
    put(this.at.advice, "This board cannot be shown");
    put(this.at.sure, words);
  }

  _lampChanged(lamp) {
    this.drawn.state = lamp.state;
    this.drawn.shows = lamp.shows;
    this.at.lamp.dataset.state = lamp.state;
    this.root.dataset.state = lamp.shows ?? lamp.state;
    put(this.at.word, lamp.word);
    announce(`${this.board.name || "board"}: ${lamp.word}. ${lamp.words}`);
  }

  /** Whether the board is live, and its sentence; the level is on its button, too, since the board may be hidden or far below. */
  _judge(lamp, now) {
    const live = ["fresh", "late", "replay"].includes(lamp.shows ?? lamp.state);
    const said = live && now !== null ? verdict(this.board, now, lamp.state === "replay") : { level: "free", sentence: lamp.words, sure: "" };
    if (this.tab !== null) this.tab.dataset.level = said.level;
    return { live, said };
  }

  _texts(lamp, now) {
    const { board, at } = this, { live, said } = this._judge(lamp, now);
    at.lamp.dataset.level = said.level;
    put(at.age, lamp.state === "replay" ? (now === null ? "" : clockWords(now).slice(0, 10)) : ageWords(lamp.age));
    put(at.advice, said.sentence);
    const calm = said.level === "good" || said.level === "free"; // else a warning on the host can wait
    put(at.sure, live && lamp.words && calm ? lamp.words : said.sure);
    if (at.sure.title !== at.sure.textContent) at.sure.title = at.sure.textContent; // it may be cut off
    if (at.advice.title !== said.sentence) at.advice.title = said.sentence;
    put(at.name, board.name || "no board yet");
    put(at.what, [board.info === null ? "" : `${board.info.array_id}, ${board.info.taxels} taxels, ${board.info.channels} channels`, this.endpoint].filter(Boolean).join(", "));
    const felt = live && board.newestScan !== null && board.geometry !== null ? board.loads() : null;
    this._loads(felt !== null && (felt.load !== null || felt.force !== null) ? felt : null);
    this._margin(live ? board.current(board.grip) : null);
    this._texture(live);
    this._strip();
    this._hover();
    showSettings(this.root, board);
    if (this._hasEvent()) { this.drawn.events = board.eventCount; this._events(); }
    if (at.readings.open) this._readings();
  }

  _loads(now) {
    const force = now?.force ?? null, unit = now?.unit;
    const centre = force === null || !this.board.isTouched() ? NONE : `${fixed(force.x_mm, 1)}, ${fixed(force.y_mm, 1)} mm`;
    const limit = force?.saturated ? "≥ " : "";
    // Readings have no standard deviation: as many decimals as three digits of a full disc have.
    const places = placesOf(this.skin.full || 1, 3), words = (value, sd) => (force === null ? `${fixed(value, places)} ${unit}` : pm(value, sd, unit));
    facts(this.at.loads, [
      ["load", now === null ? NONE : limit + words(now.load, now.loadSd)],
      ["shear", now === null || now.shear === null ? NONE : words(now.shear, now.shearSd)],
      ["towards", now === null || !(now.shear > Math.max(2 * now.shearSd, LEAST * (unit === "N" ? 1 : this.skin.full * this.board.geometry.pressure.length))) ? NONE : `${way(now.deg)}, ${fixed(now.deg, 0)}°`],
      now === null || force !== null ? ["centre", centre] : ["run", "tactiled calibrate"],
    ]);
    put(this.at.calibration, now === null ? "" : force === null ? "Not calibrated" : `Calibrated: ${force.calibration}${force.valid ? "" : ", not valid"}`);
    this.at.calibration.dataset.known = now === null || force !== null;
  }

  _margin(grip) {
    const at = this.at, held = grip !== null && grip.state !== "none" ? grip : null;
    put(at.used, held === null ? NONE : percent(held.utilisation));
    drawBar(at.bar, held);
    facts(at.margin, [
      ["interval", held === null ? NONE : `${Math.round(100 * held.utilisation_low)} to ${percent(held.utilisation_high)}`],
      ["friction", held === null ? NONE : held.unit === "N" ? `${sig(held.friction, 2)} (${sig(held.friction_low, 2)} to ${sig(held.friction_high, 2)})` : "not in newtons"],
    ]);
  }

  /** Values of the timeline under the pointer. */
  _hover() {
    const p = this.board.points, i = this.hovered, at = this.at.readout;
    if (i === null || !(i < p.t.length)) {
      put(at, `load and shear in ${this.board.unit || "the unit of the array"}${this.timeline.scaleWords(this.board)}; drag to zoom`);
      return;
    }
    put(at, [clockWords(p.t[i]), ...this.timeline.curves.map((curve) => valueWords(curve, this.board, i))].join(", "));
  }

  /** Hold the timeline at this instant, or follow the present again. */
  pause(held) {
    if (held) this.timeline.view(this.timeline.span, this.timeline.now);
    else this.timeline.view(Number(this.root.querySelector(".span").value), null);
  }

  /** Mark an instant: that under the pointer, else the newest shown. The daemon keeps those of now, where it may. */
  mark() {
    const { board, timeline } = this, hovered = this.hovered === null ? undefined : board.points.t[this.hovered];
    if (hovered === undefined && timeline.end === null && this.give !== null) { this.give("mark"); return; }
    board.mark(hovered ?? timeline.end ?? timeline.now);
  }

  _texture(live) {
    const texture = this.board.texture, at = this.at.texture;
    if (!live) { fill(at, "unknown", () => [el("p", "muted", "Unknown.")]); return; }
    if (texture === null) { fill(at, "none", () => [el("p", "muted", "The skin does not slide over grooves now.")]); return; }
    fill(at, `${texture.run}/${texture.seq}`, () => {
      if (texture.status === "ok" || texture.status === "period-only") {
        const lines = [el("p", "big number", pm(texture.period_mm, texture.period_sd_mm, "mm"))];
        lines.push(el("p", "", texture.status === "ok" ? `normal at ${pm(texture.angle_deg, texture.angle_sd_deg, "").trim()}°` : "angle not known"));
        lines.push(el("p", "muted", `${pm(texture.speed_mm_s, texture.speed_sd_mm_s, "mm/s")} (${texture.speed_source}), ${sig(texture.frequency_hz, 3)} Hz, window ${sig(texture.window_s, 2)} s`));
        return lines;
      }
      return [el("p", "big refusal", texture.status), el("p", "muted", REFUSALS[texture.status] || "")];
    });
  }

  _strip() {
    const { status: s, recording: r } = this.board;
    if (s === null) return;
    const total = s.scans + s.scans_missing;
    const loss = total > 0 ? 100 * s.scans_missing / total : 0;
    const disk = r === null ? "–" : r.state === "off" ? "off" : `${r.state}${r.file ? ` ${r.file.split("/").pop()}` : ""}, ${bytesWords(r.bytes_written)}, ${bytesWords(1e6 * r.free_mb)} free${r.reason ? `, ${r.reason}` : ""}`;
    const items = [["rate", `${sig(s.rate_hz, 4)} Hz`, "rate_hz", s.rate_hz], ["scans", `${s.scans}`, "scans", s.scans],
      ["lost", s.loss_known === false ? "not known" : `${s.scans_missing} (${loss < 0.005 ? "0" : loss.toFixed(2)} %)`, "scans_missing", s.scans_missing], ["corrupt frames", `${s.frames_corrupt}`, "frames_corrupt", s.frames_corrupt],
      ["clock", s.clock_sd_s < 1e3 ? `± ${sig(1e3 * s.clock_sd_s, 2)} ms, ${fixed(s.clock_rate_ppm, 0)} ppm` : "not known", "clock_sd_s", s.clock_sd_s],
      ["loop lag", `${sig(1e3 * s.loop_lag_s, 2)} ms`, "loop_lag_s", s.loop_lag_s], ["restarts", `${s.restarts}`, "restarts", s.restarts], ["recording", disk, "recording", r === null ? "" : r.state]];
    const strip = this.at.strip;
    strip.dataset.seq = s.seq; strip.dataset.run = s.run;
    if (strip.children.length !== items.length) strip.replaceChildren(...items.map(([label, , key]) => { const d = el("div", "fact"); d.append(el("span", "muted", label), el("b", "number", "")); d.dataset.key = key; return d; }));
    items.forEach(([, text, , raw], i) => { put(strip.children[i].lastElementChild, text); strip.children[i].dataset.value = raw; });
  }

  _events() {
    const shown = this.board.events.slice(-LISTED).reverse();
    this.at.list.replaceChildren(...shown.map((event) => {
      const { kind, text } = eventWords(event.topic, event.data);
      const li = el("li", `event ${kind}`);
      if (event.data.seq !== undefined) { li.dataset.topic = event.topic; li.dataset.seq = event.data.seq; }
      li.append(el("time", "number", clockWords(event.at)), el("span", "", event.count > 1 ? `${text} (${event.count} answers)` : text));
      return li;
    }));
  }

  _chooseChannels() {
    const g = this.board.geometry;
    if (g === null) return;
    const taxel = this.skin.chosen;
    const channels = g.taxel_of_channel.map((t, c) => (t === taxel ? c : -1)).filter((c) => c >= 0);
    this.scope.choose(channels);
    this.chooser.offer(channels.map((c, turn) => channelCurve(c, g.names[c], turn)));
    const keys = channels.map((c, i) => el("span", `key k${i % 6}`, g.names[c].split(".").pop()));
    this.at.chosen.replaceChildren(`taxel ${taxel} `, ...keys);
    this.drawn.changed = -1;
  }

  _slow(now) {
    const { board, at } = this;
    if (board.geometry !== null && this.scope.channels.length === 0) this._chooseChannels();
    board.judgeChannels();
    if (board.geometry !== null) this.skin.offerRanges(board.geometry, at.range);
    if (this.visible.get(at.scope)) this.scope.draw(board, now, this.skin.full);
    const bad = board.health.filter(Boolean).length;
    const label = `Tactile array ${board.name}: ${this.lamp.word}. ${at.advice.textContent}. ${[...at.loads.querySelectorAll("div")].map((d) => d.textContent).join(", ")}. ${bad} channels with faults.`;
    if (this.canvas.getAttribute("aria-label") !== label) this.canvas.setAttribute("aria-label", label);
  }

  _readings() {
    const g = this.board.geometry, scan = this.board.newestScan;
    if (g === null || scan === null) return;
    const table = this.at.readings.querySelector("table"), body = table.tBodies[0];
    if (body.rows.length !== g.names.length) {
      table.tHead.replaceChildren(row("th", ["channel", `reading (${g.unit})`, "state"]));
      body.replaceChildren(...g.names.map((name) => row("td", [name, "", ""])));
    }
    table.dataset.index = scan.index;
    table.dataset.run = scan.run;
    table.dataset.values = JSON.stringify(Array.from(scan.volts));
    g.names.forEach((_, c) => {
      const cells = body.rows[c].cells;
      put(cells[1], fixed(scan.volts[c], 4));
      put(cells[2], this.board.health[c] || (scan.valid[c] ? "" : "not valid"));
    });
  }
}

/** Lamp of a recording; `shows` is the state of the board at that instant, where nothing may be drawn as known. */
function recorded(board, now, words) {
  const lamp = { state: "replay", word: "REPLAY", age: null, words };
  if (board.status === null) return lamp; // made from a log that has no board
  const then = freshness(board, now, true);
  return then.state === "fresh" || then.state === "late" ? lamp : { ...lamp, shows: then.state, words: `${words} At this instant: ${then.word}. ${then.words}` };
}

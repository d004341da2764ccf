// Timeline and scope with uPlot.

import uPlot from "/static/uplot/uPlot.esm.js";
import { seriesOf, valuesOf } from "./curves.js";
import { colour, onTheme } from "./theme.js";
import { clockWords, sig } from "./words.js";

const SCOPE_S = 5;
const SERIES = ["series-1", "series-2", "series-3", "series-4", "series-5", "series-6"];
const FONT = "11px system-ui, sans-serif";
const axis = (more) => ({ stroke: () => colour("muted"), grid: { stroke: () => colour("grid"), width: 1 }, ticks: { stroke: () => colour("grid"), width: 1, size: 4 }, font: FONT, ...more });

class Plot {
  constructor(place, options, height) {
    this.place = place;
    this.height = height;
    this.plot = new uPlot({ width: Math.max(120, place.clientWidth), height, legend: { show: false }, cursor: { show: false }, ...options }, options.data, place);
    new ResizeObserver(() => { if (place.clientWidth > 60) this.plot.setSize({ width: place.clientWidth, height: this.height }); }).observe(place);
    onTheme(() => this.plot.redraw(false));
  }
}

const LANE = 17;
const LANES = ["contact", "slip", "found"];

/** Steps of 1, 2 and 5 that hold a value. */
function ladder(value) {
  const step = 10 ** Math.floor(Math.log10(value));
  return step * ([1, 2, 5, 10].find((n) => n * step >= value) ?? 10);
}

export class Timeline extends Plot {
  constructor(place, height = 218) {
    const draws = { board: null, origin: 0, top: 1, full: 1, hz: 1 };
    super(place, {
      data: [[]],
      padding: [LANES.length * LANE + 8, 6, 0, 0],
      scales: { x: { time: false, range: (u, min, max) => [min, max] }, y: { range: () => [0, draws.top] }, p: { range: [0, 1.15] },
        reading: { range: () => [-2 * draws.full, 2 * draws.full] }, hz: { range: () => [0, draws.hz] } },
      axes: [
        axis({ space: 80, size: 28,
          splits: (u, i, min, max) => {
            const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60, 120].find((s) => (max - min) / s < u.width / 90) ?? 300, found = [];
            for (let n = Math.ceil((min - draws.origin) / step); draws.origin + n * step <= max; n += 1) found.push(draws.origin + n * step);
            return found;
          },
          values: (u, ticks) => ticks.map((t) => (draws.origin ? (t < draws.origin - 0.5 ? "" : `${+(t - draws.origin).toFixed(1)} s`) : clockWords(t).slice(0, u.scales.x.max - u.scales.x.min < 10 ? 10 : 8))) }),
        axis({ size: 46, values: (u, ticks) => ticks.map((v) => sig(v, 2)) }),
        axis({ scale: "p", side: 1, size: 36, grid: { show: false }, values: (u, ticks) => ticks.map((v) => (v <= 1 ? `${Math.round(100 * v)}%` : "")) }),
      ],
      series: [{}],
      cursor: { points: { size: 7 }, y: false, drag: { x: true, y: false, setScale: false } },
      select: { show: true },
      hooks: { setSelect: [(u) => this._zoom(u)], setCursor: [(u) => this.onHover(u.cursor.idx ?? null)], drawClear: [(u) => lanesBehind(u, draws.board)], draw: [(u) => lanes(u, draws.board)] },
    }, height);
    this.draws = draws;
    this.span = 60;
    this.end = null;         // newest instant shown; null: now
    this.now = null;
    this.curves = [];
    this.onHover = () => {};
    this.onView = () => {};
  }

  /** Show these curves (see curves.js). */
  choose(curves) {
    this.curves = curves;
    this.plot.batch(() => { // curves and their values at once: the pointer may stand on them
      while (this.plot.series.length > 1) this.plot.delSeries(1);
      for (const curve of curves) this.plot.addSeries(seriesOf(curve));
      const { board } = this.draws;
      this.plot.setData(board === null ? [[], ...curves.map(() => [])] : [board.points.t, ...curves.map((curve) => valuesOf(curve, board))], false);
    });
  }

  /** What the edges of the curves without an axis are. */
  scaleWords(board) {
    const has = (scale) => this.curves.some((curve) => curve.scale === scale);
    return (has("reading") ? `, channels ±${sig(2 * this.draws.full, 2)} ${board.geometry.unit}` : "") + (has("hz") ? `, rate 0 to ${sig(this.draws.hz, 2)} Hz` : "");
  }

  /** Show `span` seconds up to `end` (null: up to now). */
  view(span, end) { this.span = span; this.end = end; this.onView(); }

  _zoom(u) {
    const { left, width } = u.select;
    if (width < 5) return;
    const from = u.posToVal(left, "x"), to = u.posToVal(left + width, "x");
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.view(Math.max(0.5, to - from), to);
  }

  /**
   * Draw what is known up to `now`; `origin` is the instant shown as 0 (a recording), or 0 for wall-clock labels.
   * The curves of readings reach the top where all discs of the skin are full, `full` each; newtons where they did.
   */
  draw(board, now, full, origin = 0) {
    this.now = now;
    this.draws.board = board; this.draws.origin = origin;
    const p = board.points, end = this.end ?? now;
    if (board.unit !== this.unit) { this.unit = board.unit; this.draws.top = 10; }
    if (board.unit !== "N") this.draws.top = full * board.geometry?.pressure.length || 1;
    else for (const v of p.load.slice(-100)) if (v > this.draws.top) this.draws.top = ladder(v);
    this.draws.full = full || 1;
    this.draws.hz = ladder(1.2 * (board.info?.rate_hz || 100));
    this.plot.batch(() => {
      this.plot.setData([p.t, ...this.curves.map((curve) => valuesOf(curve, board))], false);
      this.plot.setScale("x", { min: end - this.span, max: end });
      this.plot.setScale("y", { min: 0, max: this.draws.top });
    });
  }
}

/** Times without scans, behind the curves, and why where there is room for it. */
function lanesBehind(u, board) {
  if (board === null) return;
  const c = u.ctx, { left, top, width, height } = u.bbox;
  const x = (t) => Math.max(left, Math.min(left + width, u.valToPos(t, "x", true)));
  const r = u.pxRatio ?? window.devicePixelRatio ?? 1;
  c.save();
  c.font = `${10 * r}px system-ui, sans-serif`; c.textBaseline = "middle"; c.textAlign = "center";
  for (const gap of board.gaps) {
    const from = x(gap.from), to = Math.max(from + 2, x(gap.to));
    if (from >= left + width || to <= left + 2) continue;
    c.fillStyle = colour("gap"); c.fillRect(from, top, to - from, height);
    if (c.measureText(gap.words).width < to - from - 8 * r) { c.fillStyle = colour("muted"); c.fillText(gap.words, (from + to) / 2, top + 10 * r); }
  }
  c.restore();
}

/** Contact states, slips with the uncertainty of their onsets, textures, commands and marks, above the curves. */
function lanes(u, board) {
  if (board === null) return;
  const c = u.ctx, { left, top, width, height } = u.bbox;
  const r = u.pxRatio ?? window.devicePixelRatio ?? 1;
  const lane = LANE * r;
  const row = (n) => top - (LANES.length - n) * lane - 2 * r;
  const x = (t) => u.valToPos(t, "x", true);
  const end = Math.min(u.scales.x.max, board.knownUntil); // what holds after the newest message is not known
  c.save();
  c.font = `${10 * r}px system-ui, sans-serif`; c.textBaseline = "middle"; c.textAlign = "right"; c.fillStyle = colour("muted");
  LANES.forEach((name, n) => c.fillText(name, left - 5 * r, row(n) + lane / 2));
  c.beginPath(); c.rect(left, row(0), width, LANES.length * lane + height + 2 * r); c.clip();
  c.textAlign = "left";
  board.bands.forEach((band, i) => {
    const to = i + 1 < board.bands.length ? board.bands[i + 1].from : end;
    if (band.state === "none" || to < u.scales.x.min) return;
    const a = Math.max(left, x(band.from)), b = x(to);
    c.fillStyle = colour(`band-${band.state}`); c.fillRect(a, row(0) + 2 * r, Math.max(r, b - a - r), lane - 4 * r);
    if (b - a > 46 * r) { c.fillStyle = colour("band-ink"); c.fillText(band.state, a + 4 * r, row(0) + lane / 2); }
  });
  for (const slip of board.slips) {
    const from = x(slip.from), to = Math.max(from + 3 * r, x(slip.to ?? end));
    if (to < left) continue;
    const y0 = row(1) + 3 * r, h = lane - 6 * r;
    c.strokeStyle = c.fillStyle = colour(slip.suppressed ? "muted" : slip.kind === "gross" ? "slip" : "incipient");
    c.lineWidth = r;
    if (slip.suppressed) { c.setLineDash([3 * r, 2 * r]); c.strokeRect(from, y0, to - from, h); c.setLineDash([]); }
    else if (slip.kind === "gross") c.fillRect(from, y0, to - from, h);
    else { c.globalAlpha = 0.35; c.fillRect(from, y0, to - from, h); c.globalAlpha = 1; c.strokeRect(from, y0, to - from, h); }
    const sd = x(slip.from + slip.sd) - from; // one standard deviation of the onset to either side
    c.beginPath(); c.moveTo(from - sd, y0 + h / 2); c.lineTo(from + sd, y0 + h / 2); c.moveTo(from, y0 - 2 * r); c.lineTo(from, y0 + h + 2 * r); c.stroke();
    if (!slip.suppressed) { c.globalAlpha = 0.35; c.setLineDash([2 * r, 4 * r]); c.beginPath(); c.moveTo(from, top); c.lineTo(from, top + height); c.stroke(); c.setLineDash([]); c.globalAlpha = 1; }
  }
  for (const mark of board.marks) {
    const at = x(mark.at);
    if (at < left || at > left + width) continue;
    c.strokeStyle = c.fillStyle = colour("contact"); c.lineWidth = 1.5 * r;
    c.beginPath(); c.moveTo(at, row(2)); c.lineTo(at, top + height); c.stroke();
    const text = mark.text.slice(0, 30), wide = c.measureText(text).width + 4 * r;
    c.fillText(text, at + wide < left + width ? at + 4 * r : at - wide, top + height - 8 * r);
  }
  for (const event of board.events) {
    const at = x(event.at);
    if (at < left || !["texture", "command", "notice"].includes(event.topic)) continue;
    if (event.from < event.at - 0.05) { // answers one after the other: a bar from the first to the newest
      const a = Math.max(left, x(event.from));
      c.fillStyle = colour(event.data.status === "ok" ? "texture" : "muted"); c.globalAlpha = 0.45;
      c.fillRect(a, row(2) + 6 * r, at - a, lane - 12 * r); c.globalAlpha = 1;
    }
    const y = row(2) + lane / 2, s = 4.5 * r;
    const ok = event.topic === "texture" ? event.data.status === "ok" : event.data.ok !== false;
    c.fillStyle = c.strokeStyle = colour(event.topic === "texture" ? "texture" : event.topic === "command" ? "contact" : "broken");
    c.lineWidth = 1.5 * r;
    c.beginPath();
    if (event.topic === "texture") { c.moveTo(at, y - s); c.lineTo(at + s, y); c.lineTo(at, y + s); c.lineTo(at - s, y); }
    else { c.moveTo(at - s, y - s); c.lineTo(at + s, y - s); c.lineTo(at, y + s); }
    c.closePath();
    if (ok) c.fill(); else c.stroke();
  }
  c.restore();
}

export class Scope extends Plot {
  constructor(place, height = 170) {
    super(place, {
      data: [[]],
      scales: { x: { time: false, range: [-SCOPE_S, 0] }, y: { range: () => [-2 * (this.full ?? 1), 2 * (this.full ?? 1)] } },
      axes: [axis({ values: (u, ticks) => ticks.map((t) => `${t} s`), size: 26 }), axis({ size: 50, values: (u, ticks) => ticks.map((v) => sig(v, 3)) })],
      series: [{}],
    }, height);
    this.channels = [];
  }

  choose(channels) {
    if (channels.join() === this.channels.join()) return;
    while (this.plot.series.length > 1) this.plot.delSeries(1);
    this.channels = channels;
    channels.forEach((_, i) => this.plot.addSeries({ stroke: () => colour(SERIES[i % SERIES.length]), width: 1.2, points: { show: false } }));
  }

  /** Draw readings less their zero, within twice that of a full disc. */
  draw(board, now, full) {
    this.full = full;
    const scans = board.scans.filter((s) => s.timestamp > now - SCOPE_S);
    const step = Math.max(1, Math.ceil(scans.length / 600));
    const shown = step === 1 ? scans : scans.filter((_, i) => i % step === 0);
    for (const gap of board.gaps) { // a scan without readings breaks the curves
      const after = shown.findIndex((s) => s.timestamp >= gap.to);
      if (after > 0) shown.splice(after, 0, { timestamp: (shown[after - 1].timestamp + gap.to) / 2, volts: [], valid: [] });
    }
    this.plot.setData([shown.map((s) => s.timestamp - now), ...this.channels.map((c) => shown.map((s) => board.relative(s, c)))]);
  }
}

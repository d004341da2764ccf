// The array to scale: load as discs, shear as arrows, grooves under it, broken channels marked.

import { sum } from "./board.js";
import { colour, fit } from "./theme.js";
import { sig } from "./words.js";

const RANGES = [1, 2, 4, 8, 16, 32]; // parts of the range of the array that a full disc may stand for
const USUAL = 4;

export class SkinPicture {
  constructor(canvas, legend) {
    this.canvas = canvas;
    this.legend = legend;
    this.full = 0;           // reading of a full disc and of a full arrow, in the unit of the array
    this.ranged = null;      // geometry for which it was chosen
    this.shown = "";         // what the picture is of, as text
    this.chosen = 0;
    this.places = [];
    this.onChoose = () => {};
    canvas.addEventListener("click", (event) => this._click(event));
    canvas.addEventListener("keydown", (event) => this._key(event));
  }

  /** Places of the taxels in millimetres; a square where they are not known. */
  static layout(geometry) {
    if (geometry.has_places && geometry.x_mm.length) return geometry.x_mm.map((x, i) => ({ x, y: geometry.y_mm[i] }));
    const n = geometry.pressure.length, side = Math.ceil(Math.sqrt(n));
    return Array.from({ length: n }, (_, i) => ({ x: i % side, y: Math.floor(i / side) }));
  }

  /** Offer parts of the range of an array; the one that was chosen last, for this array, is kept. */
  offerRanges(geometry, select) {
    if (this.ranged === geometry) return;
    this.ranged = geometry;
    const whole = (geometry.high - geometry.low) / 2, key = `tactiled-range-${geometry.array}`;
    select.replaceChildren(...RANGES.map((part) => new Option(`full disc ${sig(whole / part, 2)} ${geometry.unit}`, part)));
    let kept = null;
    try { kept = localStorage.getItem(key); } catch { /* private window: not kept */ }
    select.value = RANGES.includes(Number(kept)) ? kept : USUAL;
    this.full = whole / Number(select.value);
    select.onchange = () => {
      this.full = whole / Number(select.value);
      try { localStorage.setItem(key, select.value); } catch { /* as above */ }
    };
  }

  draw(board, state) {
    const { context: c, width, height } = fit(this.canvas);
    const g = board.geometry, places = g === null ? [] : SkinPicture.layout(g);
    const scan = board.newestScan, live = state === "fresh" || state === "late" || state === "replay";
    const felt = g === null || scan === null || scan.volts.length !== board.zero.length ? null : board.felt(scan);
    const centre = live ? centreOf(board, felt, places) : null;
    const shown = this._shown(board, state, felt, centre);
    if (shown === this.shown) return;
    this.shown = shown;
    c.clearRect(0, 0, width, height);
    if (g === null) { this._words(c, width, height, "no array yet"); return; }
    const pitch = nearest(places);
    const xs = places.map((p) => p.x), ys = places.map((p) => p.y);
    const left = Math.min(...xs), right = Math.max(...xs), low = Math.min(...ys), high = Math.max(...ys);
    const span = { x: right - left + 1.24 * pitch, y: high - low + 1.24 * pitch };
    const scale = Math.min((width - 26) / span.x, (height - 26) / span.y);
    const px = (x) => width / 2 + 8 + (x - (left + right) / 2) * scale;
    const py = (y) => height / 2 - 8 - (y - (low + high) / 2) * scale;
    const rim = 0.41 * pitch * scale;
    const box = { x: px(left) - 0.62 * pitch * scale, y: py(high) - 0.62 * pitch * scale, w: span.x * scale, h: span.y * scale };

    c.save();
    roundRect(c, box.x, box.y, box.w, box.h, 0.2 * pitch * scale);
    c.fillStyle = colour("skin"); c.fill();
    c.clip();
    this._grooves(c, board, live, box, scale);
    c.restore();
    c.lineWidth = 1; c.strokeStyle = colour("line"); roundRect(c, box.x, box.y, box.w, box.h, 0.2 * pitch * scale); c.stroke();

    const inContact = new Set(board.touch !== null && board.touch.state !== "none" ? board.touch.taxels : []);
    const slipping = new Set(board.slip !== null ? board.slip.taxels : []);
    this.places = places.map((p, i) => ({ i, x: px(p.x), y: py(p.y), r: rim }));
    for (const p of this.places) {
      const load = felt === null ? 0 : felt.load[p.i];
      this._taxel(c, p, load, live, inContact.has(p.i), slipping.has(p.i), p.i === this.chosen);
    }
    if (felt !== null) for (const p of this.places) this._arrow(c, p, felt.x[p.i], felt.y[p.i], live);
    this._health(c, board);
    if (centre !== null) this._centre(c, px(centre.x), py(centre.y));
    if (live && board.slip !== null && board.slip.direction_sd_deg < 90) this._slip(c, board.slip, box);
    this._axes(c, box, scale, g);
    if (!live) this._veil(c, box, state);
    this._legendWords(g, state);
  }

  /** Text that is the same while the picture is: sizes to half a pixel, since painting costs more than all else. */
  _shown(board, state, felt, centre) {
    const { geometry: g, touch, slip, texture } = board, parts = (values) => values.map((v) => Math.round(100 * v / this.full));
    return JSON.stringify([state, this.canvas.width, this.canvas.height, colour("ink"), this.full, this.chosen, g?.array, g?.words, board.health,
      touch?.state, touch?.taxels, slip?.taxels, slip?.direction_deg, slip?.direction_sd_deg, texture?.status, texture?.period_mm, texture?.angle_deg,
      felt && [felt.load.map((v) => Math.sign(v) * Math.round(100 * Math.sqrt(Math.abs(v) / this.full))), parts(felt.x), parts(felt.y)],
      centre && [Math.round(20 * centre.x), Math.round(20 * centre.y)]]);
  }

  _taxel(c, p, load, live, touching, slipping, chosen) {
    c.beginPath(); c.arc(p.x, p.y, p.r, 0, 2 * Math.PI);
    c.strokeStyle = touching ? colour("contact") : colour("line"); c.lineWidth = touching ? 2 : 1;
    c.fillStyle = colour("taxel"); c.globalAlpha = 0.72; c.fill(); c.globalAlpha = 1; c.stroke();
    const share = Math.min(1, Math.abs(load) / this.full || 0);
    if (share > 0.004) {
      c.beginPath(); c.arc(p.x, p.y, p.r * 0.94 * Math.sqrt(share), 0, 2 * Math.PI);
      c.fillStyle = live ? ramp(share) : colour("stale");
      c.globalAlpha = load < 0 ? 0.3 : 0.95; c.fill(); c.globalAlpha = 1;
      if (share === 1) { c.strokeStyle = colour("broken"); c.lineWidth = 2; c.stroke(); } // beyond the range
      if (load < 0) { c.setLineDash([3, 3]); c.strokeStyle = colour("muted"); c.stroke(); c.setLineDash([]); }
    }
    if (slipping && live) {
      c.beginPath(); c.arc(p.x, p.y, p.r + 4, 0, 2 * Math.PI);
      c.strokeStyle = colour("slip"); c.lineWidth = 3; c.setLineDash([9, 5]); c.stroke(); c.setLineDash([]);
    }
    if (chosen) {
      c.beginPath(); c.arc(p.x, p.y, p.r + (slipping && live ? 7 : 3), 0, 2 * Math.PI);
      c.strokeStyle = colour("muted"); c.lineWidth = 1; c.setLineDash([2, 3]); c.stroke(); c.setLineDash([]);
    }
  }

  _arrow(c, p, x, y, live) {
    const size = Math.hypot(x, y) / this.full;
    if (!(size > 0.03)) return;
    const length = 1.05 * p.r * Math.min(1, size);
    const ex = p.x + length * x / Math.hypot(x, y), ey = p.y - length * y / Math.hypot(x, y); // the screen's y points down
    const head = Math.min(9, 0.5 * length);
    arrow(c, p.x, p.y, ex, ey, head, 2.5, live ? colour("ink") : colour("stale-ink"));
  }

  /** The way in which the skin slides, across the whole array. */
  _slip(c, slip, box) {
    const a = slip.direction_deg * Math.PI / 180, reach = 0.36 * Math.min(box.w, box.h);
    const x = box.x + box.w / 2, y = box.y + box.h / 2, dx = reach * Math.cos(a), dy = -reach * Math.sin(a);
    c.globalAlpha = 0.85;
    arrow(c, x - dx, y - dy, x + dx, y + dy, 26, 8, colour("slip"));
    c.globalAlpha = 1;
  }

  _grooves(c, board, live, box, scale) {
    const texture = board.texture;
    if (texture === null || texture.status !== "ok" || !live) return;
    const a = texture.angle_deg * Math.PI / 180, period = texture.period_mm * scale;
    if (!(period >= 3)) return; // finer than the screen
    const reach = Math.hypot(box.w, box.h);
    c.save();
    c.translate(box.x + box.w / 2, box.y + box.h / 2);
    c.rotate(-a);
    c.strokeStyle = colour("groove"); c.lineWidth = Math.max(1, 0.34 * period);
    c.beginPath();
    for (let x = -Math.ceil(reach / period) * period; x < reach; x += period) { c.moveTo(x, -reach); c.lineTo(x, reach); }
    c.stroke();
    c.restore();
  }

  _health(c, board) {
    const g = board.geometry;
    const bad = new Map();
    board.health.forEach((what, channel) => {
      if (!what) return;
      const taxel = g.taxel_of_channel[channel];
      bad.set(taxel, [...(bad.get(taxel) || []), `${what} ${g.names[channel].split(".").pop()}`]);
    });
    c.font = "600 11px system-ui, sans-serif"; c.textAlign = "center"; c.textBaseline = "middle";
    for (const [taxel, words] of bad) {
      const p = this.places[taxel];
      if (p === undefined) continue;
      c.strokeStyle = colour("broken"); c.lineWidth = 2.5;
      c.beginPath(); c.moveTo(p.x - 7, p.y - 7); c.lineTo(p.x + 7, p.y + 7); c.moveTo(p.x + 7, p.y - 7); c.lineTo(p.x - 7, p.y + 7); c.stroke();
      const text = words.length > 2 ? `${words.length} channels` : words.join(", ");
      c.lineWidth = 3; c.strokeStyle = colour("halo"); c.strokeText(text, p.x, p.y + p.r - 8); c.fillStyle = colour("broken"); c.fillText(text, p.x, p.y + p.r - 8);
    }
  }

  _centre(c, x, y) {
    c.strokeStyle = colour("halo"); c.lineWidth = 5; cross(c, x, y, 9); c.strokeStyle = colour("centre"); c.lineWidth = 2.5; cross(c, x, y, 9);
  }

  _axes(c, box, scale, g) {
    c.fillStyle = c.strokeStyle = colour("muted"); c.lineWidth = 1.2; c.font = "11px system-ui, sans-serif";
    const x = box.x - 9, y = box.y + box.h + 9;
    c.beginPath(); c.moveTo(x, y); c.lineTo(x + 26, y); c.lineTo(x + 22, y - 3); c.moveTo(x + 26, y); c.lineTo(x + 22, y + 3);
    c.moveTo(x, y); c.lineTo(x, y - 26); c.lineTo(x - 3, y - 22); c.moveTo(x, y - 26); c.lineTo(x + 3, y - 22); c.stroke();
    c.textAlign = "left"; c.textBaseline = "middle"; c.fillText("x", x + 30, y); c.textAlign = "center"; c.fillText("y", x, y - 33);
    if (!g.has_places) { c.textAlign = "right"; c.fillText("places not known", box.x + box.w, y + 2); return; }
    const mm = [0.5, 1, 2, 5, 10, 20, 50].find((size) => size * scale > 32) || 100;
    const end = box.x + box.w;
    c.beginPath(); c.moveTo(end - mm * scale, y - 3); c.lineTo(end - mm * scale, y + 3); c.moveTo(end - mm * scale, y); c.lineTo(end, y); c.moveTo(end, y - 3); c.lineTo(end, y + 3); c.stroke();
    c.textAlign = "right"; c.fillText(`${mm} mm`, end - mm * scale - 5, y);
  }

  _veil(c, box, state) {
    c.save();
    roundRect(c, box.x, box.y, box.w, box.h, 10); c.clip();
    c.fillStyle = colour("veil"); c.fillRect(box.x, box.y, box.w, box.h);
    c.strokeStyle = colour("veil-line"); c.lineWidth = 2; c.beginPath();
    for (let x = -box.h; x < box.w; x += 14) { c.moveTo(box.x + x, box.y + box.h); c.lineTo(box.x + x + box.h, box.y); }
    c.stroke();
    c.restore();
    this._words(c, 2 * box.x + box.w, 2 * box.y + box.h, state === "none" ? "NO BOARD" : "STALE: not live");
  }

  _words(c, width, height, words) {
    const wide = this.canvas.clientWidth - 44; // longer words are drawn narrower
    c.font = "700 20px system-ui, sans-serif"; c.textAlign = "center"; c.textBaseline = "middle";
    c.lineWidth = 6; c.strokeStyle = colour("halo"); c.strokeText(words, width / 2, height / 2, wide);
    c.fillStyle = colour("stale-ink"); c.fillText(words, width / 2, height / 2, wide);
  }

  _legendWords(g, state) {
    const words = state === "none" || state === "stale" ? "Last known picture, not live."
      : g.has_shear ? "Discs: load. Arrows: shear, in the direction of motion of the skin." : "Discs: load. No shear channels.";
    const text = g.words ? `${words} ${g.words}.` : words;
    if (this.legend.textContent !== text) this.legend.textContent = text;
  }

  _click(event) {
    const box = this.canvas.getBoundingClientRect();
    const x = event.clientX - box.left, y = event.clientY - box.top;
    const hit = this.places.find((p) => Math.hypot(p.x - x, p.y - y) < p.r * 1.05);
    if (hit !== undefined) this.choose(hit.i);
  }

  _key(event) {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const from = this.places[this.chosen];
    if (step === undefined || from === undefined) return;
    event.preventDefault(); event.stopPropagation();
    let best = null, least = Infinity;
    for (const p of this.places) {
      const along = (p.x - from.x) * step[0] + (p.y - from.y) * step[1];
      const across = Math.abs((p.x - from.x) * step[1]) + Math.abs((p.y - from.y) * step[0]);
      if (along > 1 && along + 3 * across < least) { least = along + 3 * across; best = p; }
    }
    if (best !== null) this.choose(best.i);
  }

  choose(taxel) { this.chosen = taxel; this.onChoose(taxel); }
}

/** Centre of the load in millimetres, as the daemon states it or else of the taxels in contact; null for none. */
function centreOf(board, felt, places) {
  if (!board.isTouched()) return null;
  const force = board.current(board.force);
  if (force !== null && force.x_mm !== undefined && force.valid !== false) return { x: force.x_mm, y: force.y_mm };
  if (felt === null) return null;
  const weights = felt.load.map((v) => Math.max(0, v)), total = sum(weights);
  return total > 0 ? { x: sum(weights.map((w, i) => w * places[i].x)) / total, y: sum(weights.map((w, i) => w * places[i].y)) / total } : null;
}

/** An arrow with a halo, from one point to another. */
function arrow(c, x0, y0, x1, y1, head, width, ink) {
  const length = Math.hypot(x1 - x0, y1 - y0), ux = (x1 - x0) / length, uy = (y1 - y0) / length;
  const path = () => {
    c.beginPath(); c.moveTo(x0, y0); c.lineTo(x1 - ux * head * 0.7, y1 - uy * head * 0.7); c.stroke();
    c.beginPath(); c.moveTo(x1, y1);
    c.lineTo(x1 - ux * head - uy * head * 0.6, y1 - uy * head + ux * head * 0.6);
    c.lineTo(x1 - ux * head + uy * head * 0.6, y1 - uy * head - ux * head * 0.6); c.closePath();
  };
  c.lineCap = "round"; c.lineJoin = "round";
  c.strokeStyle = c.fillStyle = colour("halo"); c.lineWidth = width + 3.5; path(); c.stroke(); c.fill();
  c.strokeStyle = c.fillStyle = ink; c.lineWidth = width; path(); c.fill();
}

function cross(c, x, y, r) {
  c.beginPath(); c.moveTo(x - r, y); c.lineTo(x + r, y); c.moveTo(x, y - r); c.lineTo(x, y + r); c.stroke();
}

function roundRect(c, x, y, w, h, r) { c.beginPath(); c.roundRect(x, y, w, h, r); }

function nearest(places) {
  let least = Infinity;
  for (let i = 0; i < places.length; i += 1) {
    for (let j = 0; j < i; j += 1) {
      const d = Math.hypot(places[i].x - places[j].x, places[i].y - places[j].y);
      if (d > 0) least = Math.min(least, d);
    }
  }
  return Number.isFinite(least) ? least : 4;
}

/** One hue from pale to full: lightness alone carries the value, for every kind of colour vision. */
function ramp(share) { return `color-mix(in oklab, ${colour("load-high")} ${Math.round(25 + 75 * share)}%, ${colour("load-low")})`; }

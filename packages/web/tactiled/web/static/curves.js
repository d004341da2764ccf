// Curves that the timeline may show: those of every board, and the channels of the chosen taxel.

import { el } from "./dom.js";
import { colour } from "./theme.js";
import { percent } from "./verdict.js";
import { sig } from "./words.js";

const KEPT = "tactiled-curves";
const FIRST = ["load", "shear", "use"];
const COLOURS = ["series-3", "series-4", "series-5", "series-6", "series-1", "series-2"]; // of channels
const number = (unit) => (v) => `${sig(v, 3)} ${unit}`;

/** Curves of every board. `column` names them in a table, and `scale` says which axis they have. */
export const CURVES = [
  { id: "load", name: "load", column: "load", scale: "y", colour: "series-1" },
  { id: "shear", name: "shear", column: "shear", scale: "y", colour: "series-2" },
  { id: "risk", name: "slip within 0.1 s", column: "p_gross_100ms", scale: "p", colour: "slip", fill: "risk-fill", words: percent },
  { id: "use", name: "in use", column: "utilisation", scale: "p", colour: "muted", dash: [4, 3], words: percent },
  { id: "sliding", name: "sliding", column: "p_sliding", scale: "p", colour: "texture", words: percent },
  { id: "rate", name: "rate", column: "rate_hz", scale: "hz", colour: "series-5", words: number("Hz") },
];

/** The curve of a channel, its reading less its zero. */
export function channelCurve(channel, name, turn) {
  return { id: `channel-${channel}`, channel, name, column: name.replace(/[^\w.]/g, "_"), scale: "reading", colour: COLOURS[turn % COLOURS.length] };
}

/** Value of a curve at one point; null where there is none. */
export function valueAt(curve, board, i) {
  if (curve.channel === undefined) return board.points[curve.id][i];
  const v = board.points.volts[i]?.[curve.channel];
  return Number.isFinite(v) ? v : null;
}

export const valuesOf = (curve, board) => (curve.channel === undefined ? board.points[curve.id] : board.points.t.map((_, i) => valueAt(curve, board, i)));

export function valueWords(curve, board, i) {
  const v = valueAt(curve, board, i);
  const words = curve.words ?? number(curve.channel === undefined ? board.unit : board.geometry.unit);
  return `${curve.name} ${v === null ? "–" : words(v)}`;
}

/** The list in which curves are chosen; `onChange(curves)` for each choice, the first at once. */
export class CurveChooser {
  constructor(place, keys, onChange) {
    this.list = place.querySelector(".choices");
    this.keys = keys;
    this.onChange = onChange;
    this.channels = [];
    let kept = null;
    try { kept = JSON.parse(localStorage.getItem(KEPT)); } catch { /* private window, or not ours */ }
    this.chosen = new Set(Array.isArray(kept) ? kept : FIRST);
    place.addEventListener("keydown", (event) => { if (event.key === "Escape") { place.open = false; place.querySelector("summary").focus(); } });
    document.addEventListener("click", (event) => { if (!place.contains(event.target)) place.open = false; });
    this._show();
  }

  /** Offer the channels of a taxel; channels of others that are chosen stay. */
  offer(channels) {
    const kept = this.channels.filter((c) => this.chosen.has(c.id) && channels.every((other) => other.id !== c.id));
    this.channels = [...kept, ...channels];
    this._show();
  }

  get curves() { return [...CURVES, ...this.channels].filter((curve) => this.chosen.has(curve.id)); }

  _show() {
    this.list.replaceChildren(...[...CURVES, ...this.channels].map((curve) => {
      const label = el("label", ""), box = el("input");
      box.type = "checkbox"; box.checked = this.chosen.has(curve.id); box.value = curve.id;
      box.onchange = () => { this.chosen[box.checked ? "add" : "delete"](curve.id); this._keep(); this._changed(); };
      label.append(box, ` ${curve.name}`);
      return label;
    }));
    this._changed();
  }

  _keep() {
    try { localStorage.setItem(KEPT, JSON.stringify(CURVES.map((curve) => curve.id).filter((id) => this.chosen.has(id)))); } catch { /* private window: not kept */ }
  }

  _changed() {
    this.keys.replaceChildren(...this.curves.map((curve) => {
      const key = el("span", "key", curve.name);
      key.style.setProperty("--key", `var(--${curve.colour})`);
      if (curve.dash) key.classList.add("dashed");
      return key;
    }));
    this.onChange(this.curves);
  }
}

/** uPlot's description of a curve. */
export const seriesOf = (curve) => ({
  scale: curve.scale, stroke: () => colour(curve.colour), width: curve.dash ? 1 : 1.5, dash: curve.dash, points: { show: false },
  fill: curve.fill ? () => colour(curve.fill) : undefined,
});

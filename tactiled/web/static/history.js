// The timeline as a file, its marks, and the controls above it.

import { download, put } from "./dom.js";
import { CURVES, valueAt } from "./curves.js";
import { colour } from "./theme.js";
import { clockWords } from "./words.js";

const HEAD_PX = 44; // two lines above the picture

/** Length, pause, mark, table and picture of the timeline of a panel. */
export function historyControls(find, panel) {
  const { timeline } = panel, span = find(".span"), pause = find(".pause");
  span.onchange = () => timeline.view(Number(span.value), null);
  pause.onclick = () => panel.pause(timeline.end === null);
  find(".mark").onclick = () => panel.mark();
  find(".save").onclick = () => download(new Blob([table(panel)], { type: "text/csv" }), `${panel.board.name || "board"}.csv`);
  find(".picture").onclick = () => picture(panel).toBlob((blob) => download(blob, `${panel.board.name || "board"}.png`));
  timeline.onView = () => {
    const paused = timeline.end !== null;
    pause.setAttribute("aria-pressed", paused);
    put(pause, paused ? "Go on" : "Pause");
  };
}

/** All points that are kept, as comma-separated values: the curves of every board, chosen channels, and marks. */
function table({ board, chooser }) {
  const curves = [...CURVES, ...chooser.curves.filter((curve) => curve.channel !== undefined)];
  const unit = (curve) => (curve.scale === "y" ? `_${board.unit}` : curve.scale === "reading" ? `_${board.geometry.unit}` : "");
  const cell = (v) => (v === null || v === undefined ? "" : +v.toPrecision(6));
  const marks = marksOfRows(board);
  const rows = board.points.t.map((t, i) => [t.toFixed(3), ...curves.map((curve) => cell(valueAt(curve, board, i))), marks.get(i) ?? ""].join(","));
  return `${["epoch_s", ...curves.map((curve) => curve.column + unit(curve)), "mark"].join(",")}\n${rows.join("\n")}\n`;
}

/** Quoted texts of the marks by the row of the first point at or after each; the last row for later ones. */
function marksOfRows({ points, marks }) {
  const found = new Map();
  for (const { at, text } of marks) {
    const i = points.t.findIndex((t) => t >= at), row = i < 0 ? points.t.length - 1 : i;
    if (row > 0 || at >= points.t[0]) found.set(row, found.has(row) ? `${found.get(row)}; ${text}` : text);
  }
  // A spreadsheet must not take a text that others wrote for a formula.
  for (const [row, text] of found) found.set(row, `"${text.replace(/^[=+\-@\t\r]/, "'$&").replaceAll('"', '""')}"`);
  return found;
}

/** The timeline as it is shown, below the board, the span and the names of the curves. */
function picture({ board, timeline, chooser }) {
  const plot = timeline.plot.ctx.canvas, r = plot.width / timeline.plot.width;
  const canvas = document.createElement("canvas");
  canvas.width = plot.width; canvas.height = plot.height + HEAD_PX * r;
  const c = canvas.getContext("2d"), { min, max } = timeline.plot.scales.x;
  c.fillStyle = colour("card"); c.fillRect(0, 0, canvas.width, canvas.height);
  c.drawImage(plot, 0, HEAD_PX * r);
  c.scale(r, r);
  c.textBaseline = "middle"; c.font = "600 13px system-ui, sans-serif"; c.fillStyle = colour("ink");
  const day = new Date(1000 * min).toLocaleDateString("en-CA");
  c.fillText(`${board.name || "board"}, ${day} ${clockWords(min)} to ${clockWords(max)}, load and shear in ${board.unit || "the unit of the array"}`, 10, 13);
  c.font = "12px system-ui, sans-serif";
  let x = 10;
  for (const curve of chooser.curves) {
    c.fillStyle = colour(curve.colour); c.fillRect(x, 30, 14, 3);
    c.fillStyle = colour("ink"); c.fillText(curve.name, x + 19, 32);
    x += 34 + c.measureText(curve.name).width;
  }
  return canvas;
}

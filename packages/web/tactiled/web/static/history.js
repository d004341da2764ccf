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
    put(pause, paused ? "Continue" : "Pause");
  };
}

/** All points that are kept, as comma-separated values: the curves of every board and chosen channels. A mark has a row. */
function table({ board, chooser }) {
  const curves = [...CURVES, ...chooser.curves.filter((curve) => curve.channel !== undefined)];
  const unit = (curve) => (curve.scale === "y" ? `_${board.unit}` : curve.scale === "reading" ? `_${board.geometry.unit}` : "");
  const cell = (v) => (v === null || v === undefined ? "" : +v.toPrecision(6));
  const points = board.points.t.map((at, i) => ({ at, cells: [...curves.map((curve) => cell(valueAt(curve, board, i))), ""] }));
  const marks = board.marks.map(({ at, text }) => ({ at, cells: [...curves.map(() => ""), quoted(text)] }));
  const rows = [...points, ...marks].sort((a, b) => a.at - b.at);
  const head = ["epoch_s", ...curves.map((curve) => curve.column + unit(curve)), "mark"];
  return `${head.join(",")}\n${rows.map(({ at, cells }) => [at.toFixed(3), ...cells].join(",")).join("\n")}\n`;
}

/** A text as a cell. A spreadsheet must not take what others wrote for a formula. */
function quoted(text) {
  return `"${text.replace(/^[=+\-@\t\r]/, "'$&").replaceAll('"', '""')}"`;
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

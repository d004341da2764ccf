// Guided force calibration: the prompts of `tactiled calibrate --guide`, then the fit to the record of a force sensor.

import { put, row } from "./dom.js";
import { makeGuide } from "./guided.js";

const UNITS = { n: "N", nmm: "N mm" };

/** Controls of a panel; `post(do, fields, signal)` asks the server, and `upload(path, file, signal)` sends it a file. */
export function guideCalibration(panel, post, upload) {
  const root = panel.root.querySelector(".calibrate"), at = (selector) => root.querySelector(selector);
  const start = at(".start"), fit = at(".fit"), reference = at(".reference"), name = at(".name"), verdict = at(".verdict");
  const run = makeGuide(root);
  let log = null, link = "";

  const enable = () => { fit.disabled = log === null || reference.files.length === 0 || !name.checkValidity(); };
  reference.onchange = name.oninput = enable;

  function showLog(found) {
    log = found.log;
    put(at(".step"), `${found.scans} scans in ${found.duration_s.toFixed(0)} s. `
      + (found.lacking === "" ? "The record shows every sensitivity. " : `The record lacks: ${found.lacking}. Record again, or fit this record. `)
      + "Now choose the record of the force sensor.");
    at(".then").hidden = false;
    enable();
  }

  function showVerdict(found) {
    put(at(".step"), `Calibration ${found.name} of ${found.array}`);
    at(".known").replaceChildren(...found.verdict.map((words) => {
      const item = document.createElement("li");
      item.textContent = words;
      return item;
    }));
    at("thead").replaceChildren(row("th", ["force", "rms error", "of a ridge regression"]));
    at("tbody").replaceChildren(...Object.entries(found.rms).map(([axis, value]) => {
      const [word, unit] = axis.split("_");
      return row("td", [word, ...[value, found.rms_of_ridge_with_squares[axis]].map((x) => `${x.toPrecision(2)} ${UNITS[unit]}`)]);
    }));
    URL.revokeObjectURL(link);
    link = URL.createObjectURL(new Blob([found.file], { type: "application/toml" }));
    Object.assign(at(".file"), { href: link, download: `${found.name}.toml`, textContent: `Save ${found.name}.toml` });
    put(at(".toml"), `[board]\ncalibration = "${found.name}.toml"`);
    verdict.hidden = false;
  }

  start.onclick = () => {
    verdict.hidden = true;
    const fields = { array: panel.board.info?.array_id ?? "", guide_s: Number(at(".guide-s").value) };
    return run(start, (signal) => post("calibrate", fields, signal), showLog);
  };
  fit.onclick = () => {
    verdict.hidden = true;
    const path = `/api/calibration?${new URLSearchParams({ log, name: name.value })}`;
    return run(fit, (signal) => upload(path, reference.files[0], signal), showVerdict);
  };
}

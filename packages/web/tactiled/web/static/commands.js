// Buttons for commands, shown only where the server accepts the token.

import { guideCalibration } from "./calibrate.js";
import { guideTuning } from "./tune.js";

const FIELDS = {
  tare: () => ({}),
  inhibit: () => ({ duration_s: 0.5 }),
  "expect-load-change": () => ({ duration_s: 0.5 }),
  mark: (root) => ({ text: root.querySelector(".mark-text").value || "mark" }),
  record: (root, board) => ({ on: board.recording === null || board.recording.state === "off" }),
  thresholds: (root) => {
    const [incipient, gross] = root.querySelector(".setting").value.split(" ").map(Number);
    return { values: { "grip.incipient_p": incipient, "grip.gross_p": gross } };
  },
  speed: (root) => ({ speed_mm_s: Number(root.querySelector(".commands .speed").value) }),
};

/** The token from the address (`#token=...`), kept for this tab and taken out of the address. */
export function takeToken() {
  const found = /[#&]token=([^&]+)/.exec(location.hash); // its characters stand for themselves in an address
  if (found) {
    sessionStorage.setItem("tactiled-token", found[1]);
    history.replaceState(null, "", location.pathname + location.search);
  }
  return sessionStorage.getItem("tactiled-token") || "";
}

export const authorization = (token) => (token ? { Authorization: `Bearer ${token}` } : {});

/** Show what is set in the daemon. A field that was edited keeps its words until its own setting changes. */
export function showSettings(root, board) {
  const { settings, recording } = board, at = (selector) => root.querySelector(`.commands ${selector}`);
  const records = recording !== null && recording.state !== "off", record = at('[data-do="record"]');
  const words = records ? "Stop recording" : "Record";
  if (record.textContent !== words) { record.textContent = words; record.setAttribute("aria-pressed", records); }
  if (settings === null) return;
  at('[data-do="tare"]').setAttribute("aria-pressed", settings.tared);
  showSetting(at(".speed"), `${settings.speed_mm_s}`);
  showSetting(at(".setting"), `${settings.incipient_p} ${settings.gross_p}`);
}

function showSetting(field, value) {
  if (field.dataset.set === value || document.activeElement === field) return;
  field.dataset.set = field.value = value;
}

/** Show the buttons of a panel; the reply of the daemon appears below them. */
export function showCommands(panel, token) {
  const section = panel.root.querySelector(".commands"), reply = section.querySelector(".reply");
  section.hidden = false;
  const post = (name, fields, signal) => fetch("/api/command", {
    method: "POST", headers: { "Content-Type": "application/json", ...authorization(token) }, signal,
    body: JSON.stringify({ source: panel.board.source, board: panel.board.name, do: name, fields }),
  });
  const upload = (path, file, signal) => fetch(path, { method: "POST", headers: authorization(token), signal, body: file });
  const send = async (button, name, fields) => {
    const label = button.textContent;
    button.disabled = true;
    let answer;
    try { answer = await (await post(name, fields)).json(); }
    catch (error) { answer = { ok: false, reason: `no answer from tactiled web (${error.message})` }; }
    button.disabled = false;
    reply.dataset.ok = answer.ok;
    reply.textContent = answer.ok ? `✓ ${label}: done` : `✗ ${label}: refused: ${answer.reason}`;
  };
  panel.give = (name) => send(section.querySelector(`[data-do="${name}"]`), name, FIELDS[name](panel.root, panel.board));
  guideTuning(panel, post, (values) => send(section.querySelector(".tune .use"), "thresholds", { values }));
  guideCalibration(panel, post, upload);
  for (const button of section.querySelectorAll("button[data-do]")) button.onclick = () => panel.give(button.dataset.do);
}

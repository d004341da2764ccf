// The recordings that the server lists: opened in this view, or downloaded.

import { el, row } from "./dom.js";
import { bytesWords } from "./words.js";

/** Query of the recording in the address of this page; empty for live boards. */
export function recordingQuery() {
  const name = new URLSearchParams(location.search).get("recording");
  return name === null ? "" : `recording=${encodeURIComponent(name)}`;
}

/** Show the list of recordings in its dialog. */
export async function listRecordings() {
  const dialog = document.getElementById("recordings"), table = dialog.querySelector("table"), words = dialog.querySelector("p");
  dialog.showModal();
  words.textContent = "Reading the directory\u2026";
  let found;
  try { found = await (await fetch("/api/recordings")).json(); }
  catch (error) { words.textContent = `no answer from tactiled web (${error.message})`; return; }
  if (found.ok === false) { words.textContent = found.reason; return; }
  words.textContent = found.length === 0 ? "There are no recordings yet." : found.some((one) => !one.opens) ? "Download larger recordings, and show them with tactiled web --file." : "";
  table.parentElement.hidden = found.length === 0;
  table.tHead.replaceChildren(row("th", ["name", "written until", "size", "look", "save"]));
  table.tBodies[0].replaceChildren(...found.map(({ name, bytes, ended, opens }) => {
    const tr = row("td", [name, new Date(1000 * ended).toLocaleString("sv-SE"), bytesWords(bytes), "", ""]), at = encodeURIComponent(name);
    if (opens) tr.cells[3].append(link("Open", `/?recording=${at}`, name));
    const save = link("Download", `/api/recordings/${at}`, name);
    save.download = name;
    tr.cells[4].append(save);
    return tr;
  }));
}

function link(text, href, name) {
  const a = el("a", "button", text);
  a.href = href;
  a.setAttribute("aria-label", `${text} ${name}`);
  return a;
}

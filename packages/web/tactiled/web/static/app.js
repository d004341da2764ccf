// Entry of the page: one panel for each board, live or from a recording.

import { BoardModel } from "./board.js";
import { authorization, showCommands, takeToken } from "./commands.js";
import { announce, el } from "./dom.js";
import { BoardPanel } from "./panel.js";
import { listRecordings, recordingQuery } from "./recordings.js";
import { Player } from "./replay.js";
import { connect, perfSeconds, ServerClock } from "./stream.js";
import { startTheme, switchTheme } from "./theme.js";
import { eventWords } from "./words.js";

const RECORDED_MS = 1000 / 15; // from one picture of a recording to the next
const SILENT_MS = 150;         // after a picture without a frame that asks for the next one: the age of the data grows
const MOST_BOARDS = 16;

const boards = new Map();  // "source/name" -> BoardPanel
const clock = new ServerClock();
const main = document.getElementById("boards");
let connected = false, session = null, token = "", player = null, dropped = 0;

function panelFor(source, name) {
  const key = `${source}/${name}`;
  if (boards.has(key)) return boards.get(key);
  const unnamed = boards.get(`${source}/`);
  if (name !== "" && unnamed !== undefined) { // the board has said who it is
    boards.delete(`${source}/`);
    boards.set(key, unnamed);
    unnamed.board.name = name;
    showBoards(null);
    return unnamed;
  }
  if (name === "") { // a daemon that waits for its board: the only panel of this endpoint is meant
    const own = [...boards.keys()].filter((known) => known.startsWith(`${source}/`));
    if (own.length === 1) return boards.get(own[0]);
  }
  if (boards.size >= MOST_BOARDS) return null;
  document.getElementById("waiting")?.remove();
  const panel = new BoardPanel(new BoardModel(source, name), main, session.endpoints.length > 1 ? session.endpoints[source] : "");
  if (session.commands) showCommands(panel, token);
  boards.set(key, panel);
  showBoards(null);
  return panel;
}

/** Return the panels in order of endpoint and name: which board spoke first differs from load to load. */
function panelsInOrder() {
  const order = (one, two) => one.board.source - two.board.source || (one.board.name < two.board.name ? -1 : 1);
  return [...boards.values()].sort(order);
}

/** Show one board, or all (null); offer the choice where there are several. */
function showBoards(chosen) {
  const panels = panelsInOrder(), place = document.getElementById("chooser");
  if (panels.some((panel, index) => panel.root !== main.children[index])) main.append(...panels.map((panel) => panel.root));
  for (const panel of panels) panel.root.hidden = chosen !== null && panel !== chosen;
  main.dataset.count = chosen === null ? panels.length : 1;
  place.hidden = panels.length < 2;
  place.replaceChildren(...[null, ...panels].map((panel) => {
    const button = el("button", "", panel === null ? "All" : panel.board.name || "no board yet");
    button.type = "button";
    button.setAttribute("aria-pressed", panel === chosen);
    button.onclick = () => showBoards(panel);
    if (panel !== null) panel.tab = button;
    return button;
  }));
}

function feed(messages) {
  for (const [source, topic, data, recovered] of messages) {
    const board = data.board ?? "";
    const panel = panelFor(source, board);
    if (panel === null) continue;
    let news = null;
    try { news = panel.board.take(topic, data, recovered); } catch (error) { console.error(topic, error); } // a lost scan or status turns the lamp by itself
    if (news === "slip" && player === null && !recovered) announce(`${board}: ${eventWords("slip", data).text}`);
  }
}

function onFrame(frame) {
  if (frame.dropped !== undefined) { dropped += frame.dropped; return; }
  feed(frame.m);
  askIfDue();
}

function askIfDue() {
  const perf = perfSeconds();
  if ([...boards.values()].some((panel) => panel.isDue(perf))) ask();
}

/** Draw with the next frame of the screen. Copying the canvases is most of what the page costs. */
function ask() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(draw);
}

let asked = false, silent = 0, lastDrawn = 0, counted = perfSeconds();
function draw(ms) {
  asked = false;
  clearTimeout(silent);
  silent = setTimeout(ask, player === null ? SILENT_MS : RECORDED_MS);
  const elapsed = Math.min(0.5, (ms - lastDrawn) / 1000);
  lastDrawn = ms;
  const now = player === null ? clock.at(perfSeconds()) : player.tick(elapsed);
  const replay = player === null ? null : { origin: player.start, words: `Recording ${player.name}. Nothing here is live.` };
  for (const panel of boards.values()) {
    try { panel.draw(now, connected, replay); } catch (error) { panel.fail(error); } // the other boards go on
  }
  askIfDue();
  const perf = perfSeconds();
  if (perf - counted > 2) {
    counted = perf;
    const words = player !== null ? "" : !connected ? "page not connected" : dropped ? `page connected; it missed ${dropped} frames` : "page connected";
    document.getElementById("link-words").textContent = words;
  }
}

function keys() {
  const help = document.getElementById("keys");
  document.getElementById("theme").onclick = switchTheme;
  document.getElementById("help").onclick = () => help.showModal();
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || ["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName)) return;
    if (event.key.toLowerCase() === "d") switchTheme();
    if (event.key === "?") help.showModal();
    if (event.key.toLowerCase() === "p") { const panels = [...boards.values()], held = panels[0]?.timeline.end === null; for (const panel of panels) panel.pause(held); }
    if (event.key.toLowerCase() === "r" && !document.getElementById("list").hidden) listRecordings();
    if (event.key.toLowerCase() === "m") for (const panel of boards.values()) if (!panel.root.hidden) panel.mark();
    if (/^[0-9]$/.test(event.key) && boards.size > 1) showBoards(panelsInOrder()[Number(event.key) - 1] ?? null);
  });
}

async function start() {
  startTheme();
  keys();
  token = takeToken();
  const query = recordingQuery();
  if (query) document.getElementById("waiting").textContent = "Reading the recording\u2026";
  while (session === null) {
    try { session = await (await fetch(`/api/session?${query}`, { headers: authorization(token) })).json(); }
    catch { await new Promise((resolve) => setTimeout(resolve, 1000)); }
  }
  const list = document.getElementById("list");
  document.getElementById("live").hidden = !query;
  list.hidden = !session.recordings && !query;
  list.onclick = listRecordings;
  if (session.ok === false) { document.getElementById("waiting").textContent = session.reason; return; }
  document.getElementById("subtitle").textContent = session.replay === null ? "" : `recording ${session.replay.name}`;
  if (session.replay === null) {
    connect(clock, session.page, onFrame, (open) => { connected = open; });
  } else {
    player = new Player(session.replay, feed, () => { for (const panel of boards.values()) panel.board.rewind(); });
    const at = /[#&]at=([\d.]+)/.exec(location.hash);
    player.seek(at ? Number(at[1]) : 0);
    addEventListener("hashchange", () => { const to = /[#&]at=([\d.]+)/.exec(location.hash); if (to) player.seek(Number(to[1])); });
  }
  ask();
}

start();

// Colours for canvases, read from the style sheet, so that there is one place for them.

const colours = new Map();
const listeners = new Set();

export function colour(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  return colours.get(name);
}

export const onTheme = (listener) => listeners.add(listener);

function changed() { colours.clear(); for (const listener of listeners) listener(); }

export function switchTheme() {
  const root = document.documentElement;
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
  try { localStorage.setItem("tactiled-theme", root.dataset.theme); } catch { /* private window: not kept */ }
  changed();
}

export function startTheme() {
  try { const kept = localStorage.getItem("tactiled-theme"); if (kept) document.documentElement.dataset.theme = kept; } catch { /* as the system has it */ }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
}

/** Fit a canvas to its place on the screen; returns its context in CSS pixels, and whether it was resized. */
export function fit(canvas) {
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  const w = Math.round(width * scale), h = Math.round(height * scale);
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  return { context, width, height };
}

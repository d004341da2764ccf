// Elements of the page: made, and written only where something has changed.

export function el(tag, kind, text) {
  const element = document.createElement(tag);
  if (kind) element.className = kind;
  if (text !== undefined) element.textContent = text;
  return element;
}

/** Write a text only where it has changed: an unchanged page costs no layout. */
export function put(element, text) { if (element.textContent !== text) element.textContent = text; }

export function fill(element, key, make) { if (element.dataset.key !== key) { element.dataset.key = key; element.replaceChildren(...make()); } }

export function row(tag, cells) { const tr = el("tr"); tr.append(...cells.map((text) => el(tag, "", text))); return tr; }

export function facts(list, rows) {
  if (list.children.length !== rows.length) list.replaceChildren(...rows.map(() => { const d = el("div"); d.append(el("dt"), el("dd", "number")); return d; }));
  rows.forEach(([name, text], i) => { put(list.children[i].firstElementChild, name); put(list.children[i].lastElementChild, text); });
}

export function announce(text) {
  const place = document.getElementById("announce");
  place.append(el("p", "", text));
  while (place.children.length > 5) place.firstElementChild.remove();
}

/** Let the user save a blob as a file. */
export function download(blob, name) {
  const link = el("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}

"use strict";
/* What all parts of the page share: the data, the state that the address keeps, and small things. */
const DATA = JSON.parse(document.getElementById("data").textContent);
DATA.rows = DATA.table.sequence.map((_, i) => ({ at: i, ...Object.fromEntries(Object.entries(DATA.table).map(([name, values]) => [name, values[i]])) }));
const $ = (id) => document.getElementById(id);
const number = (value) => typeof value === "number" ? value : value === "inf" ? Infinity : value === "-inf" ? -Infinity : NaN;
const shown = (x) => {
  if (Number.isNaN(x)) return "–";
  if (!Number.isFinite(x)) return x > 0 ? "∞" : "-∞";
  return x === 0 ? "0" : Math.abs(x) >= 1e5 ? x.toExponential(3) : String(Number(x.toPrecision(4)));
};
const baseline = (codec) => DATA.baselines.includes(codec);
const columnOf = (name) => DATA.columns[name] || { label: name, factor: 1 };
const measured = (row, name) => number(row[name]) * columnOf(name).factor;
const named = (row) => `${row.codec} ${row.setting}`.trim();
const keyOf = (row) => JSON.stringify([row.sequence, row.codec, row.setting]);

/* The state is what follows #? in the address, so that a view can be sent to somebody. */
const STATE = Object.fromEntries(new URLSearchParams(location.hash.startsWith("#?") ? location.hash.slice(2) : ""));
function remember(changes) {
  for (const [name, value] of Object.entries(changes)) {
    if (value === undefined || value === "") delete STATE[name]; else STATE[name] = String(value);
  }
  history.replaceState(null, "", `#?${new URLSearchParams(STATE)}`);
}

function fill(select, values, chosen, names) {
  select.replaceChildren(...values.map((value) => new Option(names ? names(value) : value, value, false, String(value) === String(chosen))));
}
/* Something that is tried again when the page gets another width. */
function whenResized(host, redraw) {
  let width = host.clientWidth;
  new ResizeObserver(() => {
    if (host.clientWidth !== width && host.clientWidth) { width = host.clientWidth; redraw(); }
  }).observe(host);
}
function element(name, className, text) {
  const made = document.createElement(name);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}
function swatch(style) {
  const svg = shape("svg", { width: 30, height: 12, viewBox: "0 0 30 12", "aria-hidden": "true" });
  shape("line", { x1: 0, x2: 30, y1: 6, y2: 6, stroke: style.color, "stroke-width": 2, "stroke-dasharray": (style.dashes || []).join(" ") || undefined }, svg);
  if (style.symbol) shape("path", { d: MARKERS[style.symbol], fill: style.color, transform: "translate(15 6)" }, svg);
  return svg;
}
for (const place of document.querySelectorAll("[data-curve]")) {
  const style = DATA.styles[place.dataset.curve];
  if (style) place.prepend(swatch(style));
}

/* What is looked at: a row of the table. Who shows it asks to be told. */
const watchers = [];
function look(key, scroll) {
  remember({ at: key });
  for (const tell of watchers) tell(key);
  if (scroll && $("look")) $("look").scrollIntoView({ behavior: "smooth", block: "start" });
}
document.querySelector("nav").addEventListener("click", (event) => {
  const link = event.target.closest("a");
  if (!link) return;
  event.preventDefault();
  $(link.getAttribute("href").slice(1))?.scrollIntoView({ behavior: "smooth" });
});

/* On paper a chart scales to the column, and what is folded but belongs to the answer is open. */
const opened = [];
window.addEventListener("beforeprint", () => {
  for (const svg of document.querySelectorAll("svg.chart")) svg.setAttribute("viewBox", `0 0 ${svg.getAttribute("width")} ${svg.getAttribute("height")}`);
  opened.push(...document.querySelectorAll("details.printed:not([open])"));
  for (const part of opened) part.open = true;
});
window.addEventListener("afterprint", () => { for (const part of opened.splice(0)) part.open = false; });

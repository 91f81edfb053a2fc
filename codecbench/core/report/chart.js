"use strict";
/* A chart as SVG: numbered axes, lines with markers and error bars, bands, and a cursor. It loads nothing. */
const SVG = "http://www.w3.org/2000/svg";
function shape(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) if (value !== undefined) made.setAttribute(key, value);
  if (parent) parent.append(made);
  return made;
}
const MARKERS = {
  circle: "M4,0A4,4 0 1,1 -4,0A4,4 0 1,1 4,0Z", square: "M-3.6,-3.6H3.6V3.6H-3.6Z", diamond: "M0,-5L5,0L0,5L-5,0Z",
  "triangle-up": "M0,-5L4.6,3.6H-4.6Z", cross: "M-1.6,-4.8H1.6V-1.6H4.8V1.6H1.6V4.8H-1.6V1.6H-4.8V-1.6H-1.6Z",
  x: "M-4.4,-2.4L-2.4,-4.4L0,-2L2.4,-4.4L4.4,-2.4L2,0L4.4,2.4L2.4,4.4L0,2L-2.4,4.4L-4.4,2.4L-2,0Z",
  star: "M0,-5.6L1.4,-1.9L5.3,-1.7L2.3,0.7L3.3,4.5L0,2.4L-3.3,4.5L-2.3,0.7L-5.3,-1.7L-1.4,-1.9Z",
  hexagon: "M4.8,0L2.4,4.2H-2.4L-4.8,0L-2.4,-4.2H2.4Z",
};

/* Numbers on an axis: at 1, 2 and 5 times powers of ten where these are enough, else evenly; never fewer than two. */
function even(low, high, count) {
  const power = 10 ** Math.floor(Math.log10((high - low) / count));
  let finer = [];
  for (const step of [0.2, 0.5, 1, 2, 5, 10].map((times) => times * power)) {
    const ticks = [];
    for (let at = Math.ceil(low / step - 1e-9); at * step <= high + 1e-9 * step; at++) ticks.push(Number((at * step).toPrecision(12)));
    if (ticks.length <= count + 1) return ticks.length >= 2 ? ticks : finer;
    finer = ticks;
  }
  return finer;
}
function ticksOf(low, high, log, count) {
  if (!log) return even(low, high, count);
  const found = [];
  for (const times of [[1], [1, 3], [1, 2, 5]]) {
    const ticks = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
      for (const each of times) ticks.push(Number((each * 10 ** power).toPrecision(6)));
    }
    found.push(ticks.filter((tick) => tick >= low && tick <= high));
  }
  const enough = found.find((ticks) => ticks.length >= 3 && ticks.length <= count + 2);
  const every = Math.ceil(found[0].length / count);
  return enough || (found[0].length >= 3 ? found[0].filter((_, i) => i % every === 0) : even(low, high, count));
}
const tickText = (value) => value === 0 ? "0" : Math.abs(value) >= 1e5 || Math.abs(value) < 1e-3 ? value.toExponential().replace("+", "")
  : String(Number(value.toPrecision(6)));

/* Without numbers that would stand over the one before, or say the same. room: pixels that one takes. */
function apart(ticks, scale, room) {
  const kept = [];
  for (const tick of ticks) {
    const last = kept[kept.length - 1];
    if (last === undefined || (Math.abs(scale.at(tick) - scale.at(last)) >= room && tickText(tick) !== tickText(last))) kept.push(tick);
  }
  return kept;
}

/* From values to pixels, with some room at both ends. */
function scaleOf(values, log, pixels) {
  const f = log ? Math.log10 : (x) => x;
  const known = values.filter((x) => Number.isFinite(x) && (!log || x > 0)).map(f);
  let low = Math.min(...known), high = Math.max(...known);
  if (!known.length) [low, high] = [0, 1];
  if (high - low < 1e-9 * Math.max(1, Math.abs(high))) {
    const pad = log ? 0.1 : Math.abs(high) * 0.1 || 1;
    [low, high] = [low - pad, high + pad];
  }
  return withRange(low - 0.06 * (high - low), high + 0.06 * (high - low), log, pixels);
}
function withRange(low, high, log, pixels) {
  const f = log ? Math.log10 : (x) => x;
  const at = (value) => pixels[0] + (f(value) - low) / (high - low) * (pixels[1] - pixels[0]);
  return { at, low, high, ends: log ? [10 ** low, 10 ** high] : [low, high], log };
}

/* Color and shape of what became of frames: a fate has a row of its own too, so that neither color nor shape is needed. */
const TONES = { good: { color: "var(--good)", symbol: "circle" }, fair: { color: "var(--fair)", symbol: "triangle-up" }, bad: { color: "var(--bad)", symbol: "x" } };
const LANE = 17;

/* traces: {name, x, y, text, color, symbol, dashes, width, errors: [[low, high]|null], keys}. bands: {name, low, high, value, color}.
   options: x and y {label, log}, equal, height, front: [[x, y]], pick(key), chosen, ringed: keys, asked: {value, text}, label, lanes: {from, to, of: [{name, tone, share, levels}]}.
   Gives {cursor(x, y)}. */
function chart(host, traces, bands, options) {
  const held = host.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  host.replaceChildren();
  const width = Math.max(220, host.clientWidth || 600), height = options.height;
  const svg = shape("svg", { width, height, role: options.pick ? "group" : "img", "aria-label": options.label, class: "chart" }, host);
  const xs = [...traces.flatMap((trace) => trace.x), ...(options.front || []).map((point) => point[0])];
  const ys = [...traces.flatMap((trace) => trace.y), ...bands.flatMap((band) => [band.low, band.high]),
    ...traces.flatMap((trace) => (trace.errors || []).flatMap((ends) => ends || [])), ...(options.asked ? [options.asked.value] : [])];
  const lanes = options.lanes ? options.lanes.of : [];
  const below = lanes.length ? LANE * lanes.length + 8 : 0, flat = below && !ys.some(Number.isFinite);
  const top = 10, foot = flat ? top + below : height - (options.x.label ? 42 : 24), bottom = foot - below;
  if (flat) svg.setAttribute("height", foot + 42);
  let y = scaleOf(ys, options.y.log, [bottom, top]);
  const yTicks = flat ? [] : ticksOf(...y.ends, y.log, Math.max(2, Math.floor(height / 60)));
  const left = Math.max((options.y.label ? 30 : 10) + 7 * Math.max(...yTicks.map((tick) => tickText(tick).length), 1),
    ...lanes.map((lane) => 24 + 6.6 * laneText(lane).length));
  const right = width - 12;
  let x = scaleOf(xs, options.x.log, [left, right]);
  if (options.equal) [x, y] = equal(x, y, right - left, bottom - top, [left, right], [bottom, top]);
  const marks = apart(options.equal ? ticksOf(...y.ends, false, Math.max(2, Math.floor(height / 60))) : yTicks, y, 16);
  const grid = shape("g", { class: "grid" }, svg);
  for (const tick of marks) {
    shape("line", { x1: left, x2: right, y1: y.at(tick), y2: y.at(tick) }, grid);
    shape("text", { x: left - 6, y: y.at(tick) + 4, "text-anchor": "end", class: "tick y" }, grid).textContent = tickText(tick);
  }
  const ticks = ticksOf(...x.ends, x.log, Math.max(2, Math.floor((right - left) / 75)));
  for (const tick of apart(ticks, x, 10 + 7 * Math.max(...ticks.map((tick) => tickText(tick).length), 1))) {
    shape("line", { x1: x.at(tick), x2: x.at(tick), y1: top, y2: foot }, grid);
    shape("text", { x: x.at(tick), y: foot + 16, "text-anchor": "middle", class: "tick x" }, grid).textContent = tickText(tick);
  }
  if (options.x.label) shape("text", { x: (left + right) / 2, y: foot + 36, "text-anchor": "middle", class: "axis" }, svg).textContent = options.x.label;
  if (options.y.label && !flat) {
    const middle = (top + bottom) / 2;
    shape("text", { x: 12, y: middle, "text-anchor": "middle", transform: `rotate(-90 12 ${middle})`, class: "axis" }, svg).textContent = options.y.label;
  }
  for (const band of bands) {
    const [from, to] = [y.at(band.high), y.at(band.low)];
    shape("rect", { x: left, width: right - left, y: from, height: Math.max(0, to - from), fill: band.color, opacity: 0.18 }, svg);
    shape("line", { x1: left, x2: right, y1: y.at(band.value), y2: y.at(band.value), stroke: band.color, "stroke-width": 1.5, "stroke-dasharray": "6 4", class: "band" }, svg);
  }
  if (options.asked) {
    const at = y.at(options.asked.value);
    shape("line", { x1: left, x2: right, y1: at, y2: at, stroke: "var(--good)", class: "asked" }, svg);
    const text = shape("text", { x: right - 2, y: at - top < 16 ? at + 13 : at - 4, "text-anchor": "end", class: "tick", stroke: "var(--paper)", "stroke-width": 3, "paint-order": "stroke" }, svg);
    text.textContent = options.asked.text;
  }
  const place = (point) => `${x.at(point[0]).toFixed(1)},${y.at(point[1]).toFixed(1)}`;
  if (options.front && options.front.length) shape("polyline", { points: options.front.map(place).join(" "), class: "front" }, svg);
  for (const trace of traces) drawTrace(svg, trace, x, y, options, host);
  if (options.pick) reachable([...svg.querySelectorAll(".point")], options, held);
  lanes.forEach((lane, row) => drawLane(svg, lane, options.lanes, x, left, bottom + 8 + LANE * (row + 1)));
  const cursor = shape("g", { class: "cursor" }, svg);
  return { cursor: (at, up) => drawCursor(cursor, at, up, x, y, top, foot) };
}
const percent = (share) => share > 0 && share < 0.005 ? "<1 %" : share < 1 && share > 0.995 ? ">99 %" : `${Math.round(100 * share)} %`;
const laneText = (lane) => `${lane.name} ${percent(lane.share)}`;
/* A row of bars, as high as the share of the frames there: one a frame, or one for several where there are many. */
function drawLane(svg, lane, { from, to }, x, left, base) {
  const { color, symbol } = TONES[lane.tone], parts = lane.levels, each = (to + 1 - from) / parts.length;
  const group = shape("g", { class: "lane" }, svg);
  shape("path", { d: MARKERS[symbol], fill: color, transform: `translate(${left - 12} ${base - 6})` }, group);
  shape("text", { x: left - 21, y: base - 2, "text-anchor": "end", class: "tick" }, group).textContent = laneText(lane);
  let path = "";
  for (let i = 0, end; i < parts.length; i = end) {
    for (end = i + 1; end < parts.length && parts[end] === parts[i];) end++;
    const [x0, x1] = [i, end].map((at) => x.at(from - 0.5 + at * each)), high = 13 * Number(parts[i]) / 9;
    if (high) path += `M${x0.toFixed(1)},${base}v${-high.toFixed(1)}h${Math.max(1, x1 - x0).toFixed(1)}v${high.toFixed(1)}z`;
  }
  shape("path", { d: path, fill: color }, group);
}
function equal(x, y, across, up, xPixels, yPixels) {
  const unit = Math.max((x.high - x.low) / across, (y.high - y.low) / up);
  const around = (scale, pixels, count) => {
    const middle = (scale.low + scale.high) / 2, half = unit * count / 2;
    return withRange(middle - half, middle + half, false, pixels);
  };
  return [around(x, xPixels, across), around(y, yPixels, up)];
}
function drawCursor(cursor, at, up, x, y, top, bottom) {
  cursor.replaceChildren();
  if (!Number.isFinite(at)) return;
  if (up === undefined) shape("line", { x1: x.at(at), x2: x.at(at), y1: top, y2: bottom }, cursor);
  else if (Number.isFinite(up)) shape("circle", { cx: x.at(at), cy: y.at(up), r: 6 }, cursor);
}
/* A line is broken where a value is missing. */
function drawTrace(svg, trace, x, y, options, host) {
  const known = trace.x.map((value, i) => Number.isFinite(value) && Number.isFinite(trace.y[i]));
  let path = "";
  trace.x.forEach((value, i) => { if (known[i]) path += `${i && known[i - 1] ? "L" : "M"}${x.at(value).toFixed(1)},${y.at(trace.y[i]).toFixed(1)}`; });
  if (trace.line !== false) {
    shape("path", { d: path, fill: "none", stroke: trace.color, "stroke-width": trace.width || 1.8, "stroke-dasharray": trace.dashes || undefined, class: "line" }, svg);
  }
  (trace.errors || []).forEach((ends, i) => {
    if (!ends || !known[i] || !ends.every(Number.isFinite)) return;
    const at = x.at(trace.x[i]), [low, high] = ends.map((end) => y.at(y.log ? Math.max(end, y.ends[0]) : end));
    shape("path", { d: `M${at},${low}V${high}M${at - 3},${low}H${at + 3}M${at - 3},${high}H${at + 3}`, stroke: trace.color, class: "error" }, svg);
  });
  if (!trace.symbol) return;
  trace.x.forEach((value, i) => {
    if (!known[i]) return;
    const key = trace.keys && trace.keys[i];
    const group = shape("g", { transform: `translate(${x.at(value).toFixed(1)} ${y.at(trace.y[i]).toFixed(1)})`, class: key && key === options.chosen ? "point chosen" : "point" }, svg);
    shape("circle", { r: 11, fill: "transparent", class: "hit" }, group);
    if (options.ringed && options.ringed.includes(key)) shape("circle", { r: 8, class: "ring" }, group);
    shape("path", { d: MARKERS[trace.symbol] || MARKERS.circle, fill: trace.color }, group);
    if (trace.text) tip(group, host, trace.text[i]);
    if (!key || !options.pick) return;
    group.dataset.key = key;
    group.setAttribute("role", "button"); group.setAttribute("aria-label", trace.text[i].replaceAll("\n", ", "));
    group.addEventListener("click", () => options.pick(key));
  });
}
/* One stop of the tab key for all points; arrows go from one to the next, in the order of curves. held: the key of that which had the focus. */
function reachable(points, options, held) {
  const stop = (to) => points.forEach((point) => { point.setAttribute("tabindex", point === to ? 0 : -1); });
  const of = (key) => points.find((point) => point.dataset.key === key);
  points.forEach((point, i) => point.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (step) { const to = points[(i + step + points.length) % points.length]; stop(to); to.focus(); }
    else if (event.key === "Enter" || event.key === " ") options.pick(point.dataset.key);
    else return;
    event.preventDefault();
  }));
  stop(of(held) || of(options.chosen) || points[0]);
  if (of(held)) of(held).focus({ preventScroll: true });
}
function tip(target, host, text) {
  const hide = () => host.querySelectorAll(".tip").forEach((box) => box.remove());
  const show = () => {
    hide();
    const box = document.createElement("div");
    box.className = "tip"; box.textContent = text;
    host.append(box);
    const [here, around] = [target.getBoundingClientRect(), host.getBoundingClientRect()];
    box.style.left = `${Math.max(0, Math.min(here.left - around.left + 14, around.width - box.offsetWidth))}px`;
    box.style.top = `${Math.max(0, here.top - around.top - box.offsetHeight - 4)}px`;
  };
  for (const event of ["pointerenter", "focus"]) target.addEventListener(event, show);
  for (const event of ["pointerleave", "blur"]) target.addEventListener(event, hide);
}

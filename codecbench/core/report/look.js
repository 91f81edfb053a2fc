"use strict";
/* One setting looked at: its stored frames, and its path with the error over time. */
function looking() {
  const frames = new Map(), drawings = new Map();
  for (const frame of DATA.frames) frames.set(keyOf(frame), [...(frames.get(keyOf(frame)) || []), frame]);
  for (const view of DATA.map_views) for (const drawing of view.drawings) {
    if (drawing.timeline) drawings.set(keyOf(drawing), [...(drawings.get(keyOf(drawing)) || []), { drawing, view }]);
  }
  const rows = DATA.rows.filter((row) => frames.has(keyOf(row)) || drawings.has(keyOf(row)));
  if (!rows.length) { if ($("look")) $("look").remove(); return; }
  const sequences = [...new Set(rows.map((row) => row.sequence))];
  const choose = (key) => {
    const row = rows.find((found) => keyOf(found) === key);
    $("nothing").hidden = Boolean(row);
    if (!row) { $("nothing").textContent = "The page has neither frames nor a path of this setting."; viewer.show([]); path.show([]); return; }
    fill($("look-sequence"), sequences, row.sequence);
    fill($("look-setting"), rows.filter((found) => found.sequence === row.sequence).map(keyOf), key, (value) => title(JSON.parse(value), frames.get(value)));
    viewer.show(frames.get(key) || []); path.show(drawings.get(key) || []);
  };
  const title = ([, codec, setting], found) => found ? found[0].title : `${codec} ${setting}`.trim();
  const nearest = (frame, from) => { if (from !== "path") path.at(frame); if (from !== "viewer") viewer.at(frame); };
  const viewer = frameViewer(nearest), path = pathViewer(nearest);
  $("look-sequence").addEventListener("change", () => look(keyOf(rows.find((row) => row.sequence === $("look-sequence").value))));
  $("look-setting").addEventListener("change", () => look($("look-setting").value));
  watchers.push(choose);
  /* The setting of the answer, or of the next codec that there is something to see of. */
  const first = DATA.picks.map((pick) => rows.find((row) => row.codec === pick.codec && row.setting === pick.setting)).find(Boolean)
    || rows.find((row) => !baseline(row.codec)) || rows[0];
  choose(rows.some((row) => keyOf(row) === STATE.at) ? STATE.at : keyOf(first));
}

function frameViewer(tell) {
  const part = (name) => $(`frame-${name}`);
  let stored = [], place = 0;
  if (!DATA.frames.length) { $("frames").remove(); return { show() {}, at() {} }; }
  const show = () => {
    const frame = stored[place], mode = part("mode").value;
    part("stage").dataset.mode = mode;
    $("frames").hidden = !frame;
    if (!frame) return;
    const { picture, width, height } = DATA.originals[frame.original];
    part("original").src = picture; part("decoded").src = frame.decoded; part("difference").src = frame.difference;
    const zoom = part("zoom").value;
    part("sheet").style.width = zoom === "fit" ? "100%" : `${width * Number(zoom)}px`;
    part("sheet").style.aspectRatio = `${width} / ${height}`;
    part("decoded").style.clipPath = mode === "slider" ? `inset(0 0 0 ${part("split").value}%)` : "none";
    part("line").style.left = `${part("split").value}%`;
    const flipped = part("flip").getAttribute("aria-pressed") === "true";
    part("decoded").hidden = mode === "difference" || (mode === "flip" && flipped);
    part("difference").hidden = mode !== "difference";
    part("split").parentElement.hidden = part("line").hidden = mode !== "slider";
    part("flip").hidden = mode !== "flip";
    part("marks").replaceChildren();
    part("marks").setAttribute("viewBox", `0 0 ${width} ${height}`);
    part("marked").parentElement.hidden = !frame.note;
    if (part("marked").checked && frame.note) for (const [kind, list] of [["kept", frame.kept], ["lost", frame.lost]]) {
      for (let i = 0; i < list.length; i += 2) shape("circle", { cx: list[i], cy: list[i + 1], r: kind === "lost" ? 4 : 2.5, class: kind }, part("marks"));
    }
    const said = { slider: "original left of the line, decoded right of it", flip: flipped ? "original" : "decoded", difference: "difference in gray, amplified 4 times, around middle gray" }[mode];
    part("caption").textContent = [`frame ${frame.frame}`, said, frame.note && `${frame.note} over the whole frame${part("marked").checked ? "; lost keypoints are red" : ""}`].filter(Boolean).join("; ");
    remember({ frame: frame.frame, mode, zoom });
  };
  part("mode").addEventListener("change", () => { part("marked").checked = part("mode").value === "difference"; show(); });
  for (const name of ["zoom", "marked"]) part(name).addEventListener("change", show);
  part("split").addEventListener("input", show);
  part("flip").addEventListener("click", () => { part("flip").setAttribute("aria-pressed", String(part("flip").getAttribute("aria-pressed") !== "true")); show(); });
  part("index").addEventListener("change", () => { place = Number(part("index").value); show(); tell(stored[place].frame, "viewer"); });
  if (["slider", "flip", "difference"].includes(STATE.mode)) part("mode").value = STATE.mode;
  if (["fit", "1", "2", "4"].includes(STATE.zoom)) part("zoom").value = STATE.zoom;
  const closest = (frame) => stored.reduce((best, each, i) => Math.abs(each.frame - frame) < Math.abs(stored[best].frame - frame) ? i : best, 0);
  return {
    show: (found) => {
      const before = stored.length ? stored[place].frame : Number(STATE.frame ?? NaN);
      stored = found;
      place = !found.length ? 0 : Number.isFinite(before) ? closest(before) : Math.floor((found.length - 1) / 2);
      fill(part("index"), found.map((_, i) => i), place, (i) => `frame ${found[i].frame}`);
      show();
    },
    at: (frame) => { if (stored.length) { place = closest(frame); part("index").value = place; show(); } },
  };
}

/* What became of each frame: its way on a map, if it has one, and below it what was made of it and how far off that was. */
function pathViewer(tell) {
  const host = $("path");
  if (!host) return { show() {}, at() {} };
  let found = [], place = 0, map = null, error = null;
  const here = () => found[Number($("path-way").value) || 0], timelineOf = () => here().drawing.timeline;
  const wayOf = ({ drawing, view }) => [view.title, drawing.way].filter(Boolean).join(": ");
  const draw = () => {
    const { drawing, view } = here(), timeline = drawing.timeline;
    $("path-map").hidden = $("path-strokes").hidden = !timeline.x;
    const lost = timeline.frames.map((_, i) => Boolean(timeline.x) && timeline.x[i] === null);
    if (timeline.x) drawMap(drawing, view, timeline, lost);
    const errors = timeline.errors.map((value) => value ?? NaN), most = Math.max(...errors.filter(Number.isFinite), 0);
    const known = errors.some(Number.isFinite), told = timeline.rows.map(laneText).join(", ");
    const missing = { name: "lost", x: timeline.frames.map((frame, i) => lost[i] ? frame : NaN), y: errors.map(() => 0), color: "var(--bad)", width: 6 };
    $("path-error").hidden = !known && !lost.some(Boolean) && !told;
    error = chart($("path-error"), [{ name: timeline.quantity, x: timeline.frames, y: errors, color: "var(--accent)" }, ...(told ? [] : [missing])],
      known || !told ? [{ low: 0, high: 0, value: 0, color: "var(--line)" }] : [], {
        height: 190 + LANE * timeline.rows.length, x: { label: "frame" }, y: { label: `${timeline.quantity} [${timeline.unit}]` },
        lanes: { from: timeline.frames[0], to: timeline.last, of: timeline.rows },
        label: `Timeline. ${known ? `${timeline.quantity}: at most ${shown(most)} ${timeline.unit}` : `No known ${timeline.quantity}`}. ${told ? `Frames: ${told}` : "Frames without a pose are marked"}.`,
      });
    $("path-scrub").max = timeline.frames.length - 1;
    move();
  };
  const drawMap = (drawing, view, timeline, lost) => {
    const lines = drawing.lines.map((line) => {
      const style = DATA.strokes[line.stroke], [x, y] = view.paths[line.path];
      return { name: line.name, x, y, color: style.color, dashes: style.dashes, width: style.width };
    });
    /* A loss is marked where the camera was last known to be. */
    const before = timeline.frames.map((_, i) => i).filter((i) => !lost[i] && lost[i + 1]);
    const losses = { name: "lost", x: before.map((i) => timeline.x[i]), y: before.map((i) => timeline.y[i]), color: "var(--bad)", symbol: "x", line: false,
      text: before.map((i) => `lost after frame ${timeline.frames[i]}`) };
    map = chart($("path-map"), [...lines, losses], [], { height: 300, equal: true, x: { label: drawing.axes[0] }, y: { label: drawing.axes[1] }, label: `Path: ${drawing.caption}` });
  };
  const move = () => {
    const timeline = timelineOf(), from = timeline.frames[place], to = (timeline.frames[place + 1] ?? timeline.last + 1) - 1;
    $("path-scrub").value = place;
    if (timeline.x) map.cursor(timeline.x[place] ?? NaN, timeline.y[place] ?? NaN);
    error.cursor(from);
    const far = timeline.errors[place];
    const lanes = timeline.rows.filter((lane) => {
      const [first, last] = [from, to].map((frame) => Math.floor((frame - timeline.frames[0]) / (timeline.last + 1 - timeline.frames[0]) * lane.levels.length));
      return /[1-9]/.test(lane.levels.slice(first, last + 1));
    });
    const known = far !== null ? `${timeline.quantity} ${from < to ? "up to " : ""}${shown(far)} ${timeline.unit}`
      : timeline.x && timeline.x[place] === null ? `no pose${lanes.length ? "" : " (lost)"}` : `no known ${timeline.quantity}`;
    $("path-caption").textContent = `${here().drawing.caption}. Frame${from < to ? `s ${from} to ${to}` : ` ${from}`}: ${[...lanes.map((lane) => lane.name), known].join(", ")}`;
  };
  const closest = (frame) => timelineOf().frames.reduce((best, each, i, all) => Math.abs(each - frame) < Math.abs(all[best] - frame) ? i : best, 0);
  $("path-scrub").addEventListener("input", () => { place = Number($("path-scrub").value); move(); tell(timelineOf().frames[place], "path"); });
  $("path-way").addEventListener("change", () => { remember({ of: wayOf(here()) }); place = 0; draw(); });
  whenResized(host, () => { if (found.length) draw(); });
  return {
    /* What moves on a map comes first, and what was looked at last stays. */
    show: (drawings) => {
      const before = found.length ? timelineOf().frames[place] : Number(STATE.frame ?? 0);
      found = [...drawings].sort((a, b) => Number(!a.drawing.timeline.x) - Number(!b.drawing.timeline.x)); host.hidden = !found.length;
      if (!found.length) return;
      const titles = new Set(found.map(({ view }) => view.title));
      fill($("path-way"), found.map((_, i) => i), Math.max(0, found.findIndex((each) => wayOf(each) === STATE.of)),
        (i) => titles.size > 1 || !found[i].drawing.way ? wayOf(found[i]) : found[i].drawing.way);
      $("path-way").parentElement.hidden = found.length < 2;
      place = closest(before); draw();
    },
    at: (frame) => { if (found.length) { place = closest(frame); move(); } },
  };
}

/* Small multiples of what an evaluator drew; a click looks closer. */
function multiples(view, id) {
  const part = (name) => $(`${id}-${name}`);
  const sequences = [...new Set(view.drawings.map((drawing) => drawing.sequence))], all = "all codecs";
  fill(part("sequence"), sequences, sequences[0]);
  const names = [...new Set(view.drawings.map((drawing) => drawing.codec))];
  const few = view.drawings.filter((drawing) => drawing.sequence === sequences[0]).length <= 12;
  fill(part("codec"), [all, ...names], few ? all : names.find((name) => !baseline(name)) || all);
  const plot = () => {
    const codec = part("codec").value;
    const chosen = view.drawings.filter((drawing) => drawing.sequence === part("sequence").value
      && (codec === all || drawing.codec === codec || baseline(drawing.codec)));
    const boxes = chosen.map((drawing) => {
      const box = element("figure", "multiple"), host = element("div"), caption = element("figcaption", drawing.holds === false ? "bad" : "");
      const words = `${named(drawing)} ${drawing.way}`.trim() + `: ${drawing.caption}`;
      if (drawing.timeline) {
        const open = element("button", "link", words); open.type = "button";
        open.addEventListener("click", () => { remember({ of: [view.title, drawing.way].filter(Boolean).join(": ") }); look(keyOf(drawing), true); });
        caption.append(open);
      } else caption.textContent = words;
      box.append(host, caption);
      return [box, host, drawing];
    });
    part("multiples").replaceChildren(...boxes.map(([box]) => box));
    for (const [, host, drawing] of boxes) {
      const [across, up] = drawing.axes;
      chart(host, drawing.lines.map((line) => {
        const style = DATA.strokes[line.stroke], [x, y] = view.paths[line.path];
        return { name: line.name, x, y, color: style.color, dashes: style.dashes, width: style.width };
      }), [], { height: 190, equal: drawing.is_plane, x: { label: across }, y: { label: up }, label: `${named(drawing)}: ${drawing.caption}` });
    }
  };
  for (const name of ["sequence", "codec"]) part(name).addEventListener("change", plot);
  plot();
}

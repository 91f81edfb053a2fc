"use strict";
/* Curves: any column over any other, with what is missing said and empty views not offered. */
function curves() {
  const columns = Object.keys(DATA.columns), names = [...new Set(DATA.rows.map((row) => row.curve))];
  const both = (sequence, x, y) => DATA.rows.filter((row) => row.sequence === sequence
    && Number.isFinite(measured(row, x)) && Number.isFinite(measured(row, y)));
  const has = (sequence, preset) => both(sequence, preset.x, preset.y).some((row) => !baseline(row.codec)) || both(sequence, preset.x, preset.y).length;
  const sequences = DATA.sequences.filter((name) => DATA.presets.some((preset) => has(name, preset)));
  if (!sequences.length) { $("curves").remove(); return; }
  const off = new Set(JSON.parse(STATE.off || "[]"));
  const first = sequences.find((name) => has(name, DATA.presets[DATA.first])) || sequences[0];
  fill($("sequence"), sequences, sequences.includes(STATE.seq) ? STATE.seq : first);
  const usual = (open) => open.includes(DATA.first) ? DATA.first : open[0];
  const offer = () => {
    const sequence = $("sequence").value;
    const open = DATA.presets.map((_, i) => i).filter((i) => has(sequence, DATA.presets[i]));
    fill($("preset"), open, open.find((i) => DATA.presets[i].x === $("x").value && DATA.presets[i].y === $("y").value) ?? usual(open), (i) => DATA.presets[i].title);
  };
  /* Only columns that have a number on the sequence. */
  const fillColumns = (select, chosen) => {
    const groups = new Map(), here = DATA.rows.filter((row) => row.sequence === $("sequence").value);
    for (const name of columns.filter((column) => here.some((row) => Number.isFinite(measured(row, column))))) {
      const facts = DATA.columns[name];
      if (!groups.has(facts.group)) groups.set(facts.group, Object.assign(document.createElement("optgroup"), { label: facts.group }));
      const option = new Option(facts.label, name, false, name === chosen);
      option.title = `${name}: ${facts.summary}`;
      groups.get(facts.group).append(option);
    }
    select.replaceChildren(...groups.values());
  };
  const rescale = (axis) => { $(`log${axis}`).checked = columnOf($(axis).value).scale === "log"; };
  const apply = () => {
    const preset = DATA.presets[$("preset").value];
    if (!preset) return;
    $("x").value = preset.x; $("y").value = preset.y;
    rescale("x"); rescale("y"); plot();
  };
  const sign = (name) => ({ lower: 1, higher: -1 })[columnOf(name).better];
  /* Points that no other beats in both columns; none where a column has no better direction. */
  const frontOf = (rows, x, y) => {
    const [sx, sy] = [sign(x), sign(y)];
    if (!sx || !sy) return [];
    const points = rows.map((row) => [measured(row, x), measured(row, y)]);
    const beats = (a, b) => sx * a[0] <= sx * b[0] && sy * a[1] <= sy * b[1] && (a[0] !== b[0] || a[1] !== b[1]);
    return points.filter((p) => !points.some((other) => beats(other, p))).sort((a, b) => a[0] - b[0]);
  };
  const errorsOf = (rows, name) => {
    const ends = DATA.intervals[name];
    return ends && rows.map((row) => ends[row.at] && ends[row.at].map((end) => end * columnOf(name).factor).sort((a, b) => a - b));
  };
  const words = (row, x, y) => {
    const ends = (errorsOf([row], y) || [])[0];
    return `${named(row)}\n${columnOf(x).label}: ${shown(measured(row, x))}\n${columnOf(y).label}: ${shown(measured(row, y))}`
      + (ends ? ` (95 %: ${shown(ends[0])} to ${shown(ends[1])})` : "");
  };
  const plot = () => {
    const [x, y, sequence] = [$("x").value, $("y").value, $("sequence").value];
    const [logx, logy] = [$("logx").checked, $("logy").checked];
    const fits = (row) => (!logx || measured(row, x) > 0) && (!logy || measured(row, y) > 0);
    const rows = both(sequence, x, y).filter(fits);
    /* Over the rate the baseline is a level to reach, not a point far to the right. */
    const level = x === DATA.rate && rows.some((row) => !baseline(row.codec)) ? rows.filter((row) => baseline(row.codec)) : [];
    const pointed = rows.filter((row) => !level.includes(row) && !off.has(row.curve));
    const traces = names.map((curve) => {
      const own = pointed.filter((row) => row.curve === curve).sort((a, b) => a.place - b.place || measured(a, x) - measured(b, x));
      const style = DATA.styles[curve];
      return { name: curve, x: own.map((row) => measured(row, x)), y: own.map((row) => measured(row, y)), color: style.color, symbol: style.symbol,
        dashes: style.dashes.join(" "), text: own.map((row) => words(row, x, y)), errors: errorsOf(own, y), keys: own.map(keyOf) };
    }).filter((trace) => trace.x.length);
    const bands = level.filter((row) => !off.has(row.curve)).map((row) => {
      const value = measured(row, y), ends = (errorsOf([row], y) || [])[0] || [value, value];
      return { low: ends[0], high: ends[1], value, color: DATA.styles[row.curve].color };
    });
    const asked = DATA.asked[y]?.[sequence], bound = asked === undefined ? NaN : asked * columnOf(y).factor;
    const ringed = pointed.filter((row) => DATA.picks.some((pick) => pick.passes && pick.codec === row.codec && pick.setting === row.setting)).map(keyOf);
    const front = $("front").checked ? frontOf(pointed, x, y) : [];
    chart($("curve"), traces, bands, {
      height: Math.max(300, Math.min(460, $("curve").clientWidth * 0.75)), label: `${columnOf(y).label} over ${columnOf(x).label}, one line per codec; the table below has the numbers`,
      x: { label: columnOf(x).label, log: logx }, y: { label: columnOf(y).label, log: logy }, chosen: STATE.at, ringed,
      asked: Number.isFinite(bound) && (!logy || bound > 0) ? { value: bound, text: `${columnOf(y).better === "higher" ? "≥" : "≤"} ${shown(bound)} required` } : undefined,
      front, pick: (key) => look(key, true),
    });
    legend(rows, level, front.length > 0, ringed.length > 0);
    const left = DATA.rows.filter((row) => row.sequence === sequence && !rows.includes(row));
    $("left-out").textContent = left.length ? `Without a value here: ${left.map(named).join("; ")}.` : "";
    remember({ seq: sequence, x, y, logx: Number(logx), logy: Number(logy), front: Number($("front").checked), off: off.size ? JSON.stringify([...off]) : "" });
  };
  const legend = (rows, level, fronted, ringed) => {
    const present = names.filter((curve) => rows.some((row) => row.curve === curve));
    const focused = document.activeElement && document.activeElement.dataset.toggle;
    $("legend").replaceChildren(...present.map((curve) => {
      const isLevel = level.some((row) => row.curve === curve);
      const button = element("button", "toggle", isLevel ? `${curve} (level)` : curve);
      button.type = "button"; button.dataset.toggle = curve;
      button.setAttribute("aria-pressed", String(!off.has(curve)));
      button.prepend(swatch(isLevel ? { color: DATA.styles[curve].color, dashes: [6, 4] } : DATA.styles[curve]));
      button.addEventListener("click", () => { if (!off.delete(curve)) off.add(curve); plot(); });
      return button;
    }));
    if (fronted) $("legend").append(element("span", "front-name", "Pareto front"));
    if (ringed) $("legend").append(element("span", "soft", "○ coarsest that passes"));
    if (focused) [...$("legend").children].find((button) => button.dataset.toggle === focused)?.focus();
  };
  const another = () => {
    const [x, y] = [$("x").value, $("y").value];
    fillColumns($("x"), x); fillColumns($("y"), y);
    offer();
    if ($("x").value === x && $("y").value === y && both($("sequence").value, x, y).length) plot(); else apply();
  };
  for (const axis of ["x", "y"]) $(axis).addEventListener("change", () => { rescale(axis); offer(); plot(); });
  for (const id of ["logx", "logy", "front"]) $(id).addEventListener("change", plot);
  $("sequence").addEventListener("change", another);
  $("preset").addEventListener("change", apply);
  whenResized($("curve"), plot);
  watchers.push(plot);
  const asked = { x: STATE.x, y: STATE.y, logx: STATE.logx, logy: STATE.logy };
  $("front").checked = STATE.front !== "0";
  fillColumns($("x"), ""); fillColumns($("y"), ""); $("x").value = $("y").value = ""; offer();
  $("preset").parentElement.hidden = !DATA.presets.length;
  if (asked.x in DATA.columns && asked.y in DATA.columns && both($("sequence").value, asked.x, asked.y).length) {
    $("x").value = asked.x; $("y").value = asked.y;
    $("logx").checked = asked.logx === "1"; $("logy").checked = asked.logy === "1";
    offer(); plot();
  } else apply();
}

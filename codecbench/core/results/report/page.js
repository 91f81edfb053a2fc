"use strict";
const DATA = JSON.parse(document.getElementById("data").textContent);
DATA.rows = DATA.table.sequence.map((_, i) => Object.fromEntries(Object.entries(DATA.table).map(([name, values]) => [name, values[i]])));
const dark = matchMedia("(prefers-color-scheme: dark)");
// Okabe and Ito's palette, which colour-blind readers can tell apart, with marker shapes beside it.
const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6BB1", "#999999"];
const SYMBOLS = ["circle", "square", "diamond", "triangle-up", "cross", "x", "star", "hexagon"];
const codecs = [...new Set(DATA.rows.map((row) => row.curve))];
const style = Object.fromEntries(codecs.map((codec, i) => [codec, {
  color: codec === "raw" ? "#777777" : COLOURS[i % COLOURS.length], symbol: SYMBOLS[i % SYMBOLS.length],
}]));
const $ = (id) => document.getElementById(id);
const number = (value) => typeof value === "number" ? value : value === "inf" ? Infinity : NaN;
const shown = (value) => {
  const x = number(value);
  if (Number.isNaN(x)) return "–";
  if (!Number.isFinite(x)) return "∞";
  return x === 0 ? "0" : Math.abs(x) >= 1e5 ? x.toExponential(3) : String(Number(x.toPrecision(4)));
};

function layout(extra) {
  const ink = getComputedStyle(document.documentElement).getPropertyValue("--ink").trim();
  const line = getComputedStyle(document.documentElement).getPropertyValue("--line").trim();
  const axis = { gridcolor: line, zerolinecolor: line, linecolor: line, automargin: true };
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink, family: "system-ui, sans-serif" },
    margin: { l: 56, r: 16, t: 20, b: 48 }, legend: { orientation: "h", y: -0.2 }, hovermode: "closest",
    modebar: { bgcolor: "rgba(0,0,0,0)", color: line, activecolor: ink }, ...extra,
    xaxis: { ...axis, ...(extra.xaxis || {}) }, yaxis: { ...axis, ...(extra.yaxis || {}) },
  };
}
const CONFIG = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
const draw = (id, traces, extra, config = CONFIG) => Plotly.react(id, traces, layout(extra), config);

function fill(select, values, chosen, names) {
  for (const value of values) {
    const option = new Option(names ? names(value) : value, value);
    option.selected = value === chosen;
    select.add(option);
  }
}
const columnName = (column) => {
  const facts = DATA.columns[column];
  return facts && facts.unit && facts.unit !== "1" ? `${column} [${facts.unit}]` : column;
};

/* Curves: any column against any other. */
function curves() {
  const columns = Object.keys(DATA.columns);
  const pick = (...wanted) => wanted.find((name) => columns.includes(name)) || columns[0];
  fill($("x"), columns, pick("quality.rate_bpp.mean", "quality.size_bytes.mean"), columnName);
  fill($("y"), columns, pick("quality.psnr_gray_db.mean", "trajectory.ate_rmse_m.median"), columnName);
  fill($("sequence"), DATA.sequences, DATA.sequences[0]);
  fill($("preset"), DATA.presets.map((_, i) => i), 0, (i) => DATA.presets[i].title);
  const apply = () => {
    const preset = DATA.presets[$("preset").value];
    if (!preset) return;
    $("x").value = preset.x; $("y").value = preset.y;
    $("logx").checked = preset.logx; $("logy").checked = preset.logy;
    plot();
  };
  /* Points that no other beats in both of the chosen columns; none where a column has no better direction. */
  const frontOf = (traces, x, y) => {
    const sign = (column) => ({ lower: 1, higher: -1 })[(DATA.columns[column] || {}).better];
    const [sx, sy] = [sign(x), sign(y)];
    if (!sx || !sy) return [];
    const points = traces.flatMap((trace) => trace.x.map((value, i) => [value, trace.y[i]]));
    const beats = (a, b) => sx * a[0] <= sx * b[0] && sy * a[1] <= sy * b[1] && (a[0] !== b[0] || a[1] !== b[1]);
    return points.filter((p) => !points.some((other) => beats(other, p))).sort((a, b) => a[0] - b[0]);
  };
  const scale = (log) => log ? { type: "log", dtick: Math.log10(2), tick0: 0, tickformat: ".3~g" } : { type: "linear" };
  const plot = () => {
    const [x, y, sequence] = [$("x").value, $("y").value, $("sequence").value];
    const traces = codecs.map((codec) => {
      const rows = DATA.rows.filter((row) => row.curve === codec && row.sequence === sequence
        && Number.isFinite(number(row[x])) && Number.isFinite(number(row[y])))
        .sort((a, b) => number(a[x]) - number(b[x]));
      const bars = (column) => {
        const [low, high] = DATA.intervals[column] || [];
        if (!low) return undefined;
        return { type: "data", symmetric: false, thickness: 1, array: rows.map((r) => number(r[high]) - number(r[column])),
          arrayminus: rows.map((r) => number(r[column]) - number(r[low])) };
      };
      return { name: codec, x: rows.map((r) => number(r[x])), y: rows.map((r) => number(r[y])),
        text: rows.map((r) => r.setting), mode: "lines+markers", type: "scatter", error_y: bars(y), error_x: bars(x),
        line: { color: style[codec].color, width: 1.6 }, marker: { symbol: style[codec].symbol, size: 9, color: style[codec].color },
        hovertemplate: `<b>${codec}</b> %{text}<br>${x} %{x:.5g}<br>${y} %{y:.5g}<extra></extra>` };
    }).filter((trace) => trace.x.length);
    const front = $("front").checked ? frontOf(traces, x, y) : [];
    if (front.length) traces.push({ name: "Pareto front", x: front.map((p) => p[0]), y: front.map((p) => p[1]), mode: "lines",
      type: "scatter", line: { color: "#8a8f98", width: 8 }, opacity: 0.35, hoverinfo: "skip" });
    const left = DATA.rows.filter((row) => row.sequence === sequence && !(Number.isFinite(number(row[x])) && Number.isFinite(number(row[y]))));
    $("left-out").textContent = left.length
      ? `Without a finite value here: ${left.map((r) => `${r.codec} ${r.setting}`.trim()).join("; ")}.` : "";
    draw("curve", traces, {
      showlegend: true,
      xaxis: { title: { text: columnName(x) }, ...scale($("logx").checked) },
      yaxis: { title: { text: columnName(y) }, ...scale($("logy").checked) },
    });
  };
  for (const id of ["x", "y", "sequence", "logx", "logy", "front"]) $(id).addEventListener("change", plot);
  $("preset").addEventListener("change", apply);
  if (DATA.presets.length) apply(); else plot();
}

/* Trajectories: small multiples over ground truth. */
function trajectories() {
  if (!DATA.trajectories.length) return;
  const sequences = [...new Set(DATA.trajectories.map((one) => one.sequence))];
  fill($("trajectory-sequence"), sequences, sequences[0]);
  const names = [...new Set(DATA.trajectories.map((one) => one.codec))];
  const few = DATA.trajectories.filter((one) => one.sequence === sequences[0]).length <= 12;
  fill($("trajectory-codec"), ["all codecs", ...names], few ? "all codecs" : names.find((name) => name !== "raw"));
  const plot = () => {
    const host = $("multiples");
    for (const old of host.querySelectorAll(".plot")) Plotly.purge(old);
    host.replaceChildren();
    const codec = $("trajectory-codec").value;
    const chosen = DATA.trajectories.filter((one) => one.sequence === $("trajectory-sequence").value
      && (codec === "all codecs" || one.codec === codec || one.codec === "raw"));
    chosen.forEach((one, i) => {
      const box = document.createElement("div");
      const caption = document.createElement("figcaption");
      caption.textContent = `${one.codec} ${one.setting}`.trim() + ` — ${one.caption}`;
      const plotted = document.createElement("div");
      plotted.className = "plot"; plotted.id = `trajectory-${i}`;
      box.append(plotted, caption); host.append(box);
      const line = (name, points, color, dash, width) => ({ name, x: points[0], y: points[1], mode: "lines", type: "scatter",
        line: { color, dash, width }, hoverinfo: "name" });
      const traces = [];
      if (one.truth) traces.push(line("ground truth", one.truth, "#8a8f98", "solid", 3));
      if (one.estimate) traces.push(line("estimated", one.estimate, "#E69F00", "dot", 1.4));
      if (one.optimised) traces.push(line("optimised", one.optimised, "#0072B2", "solid", 1.6));
      draw(plotted.id, traces, { margin: { l: 34, r: 6, t: 6, b: 26 }, showlegend: false, yaxis: { scaleanchor: "x" } },
        { ...CONFIG, displayModeBar: false });
    });
  };
  for (const id of ["trajectory-sequence", "trajectory-codec"]) $(id).addEventListener("change", plot);
  plot();
}

/* Frames: original, decoded, difference. */
function frames() {
  if (!DATA.frames.length) return;
  const sequences = [...new Set(DATA.frames.map((one) => one.sequence))];
  fill($("frame-sequence"), sequences, sequences[0]);
  const show = () => {
    const one = DATA.frames[$("frame-setting").value];
    $("frame-original").src = DATA.originals[one.original];
    $("frame-decoded").src = one.decoded;
    $("frame-difference").src = one.difference;
    $("frame-decoded-caption").textContent = one.caption;
    $("frame-lost-caption").textContent = one.lost;
  };
  const choose = () => {
    $("frame-setting").replaceChildren();
    const chosen = DATA.frames.map((_, i) => i).filter((i) => DATA.frames[i].sequence === $("frame-sequence").value);
    fill($("frame-setting"), chosen, chosen[0], (i) => DATA.frames[i].title);
    show();
  };
  $("frame-sequence").addEventListener("change", choose);
  $("frame-setting").addEventListener("change", show);
  choose();
}

/* Operations: stages stacked by class. */
function operations() {
  if (!DATA.operations.length) return;
  const kinds = [...new Set(DATA.operations.map((one) => one.family))];
  const sequences = [...new Set(DATA.operations.map((one) => one.sequence))];
  fill($("operation-family"), kinds, kinds[0]);
  fill($("operation-sequence"), sequences, sequences[0]);
  const plot = () => {
    const chosen = DATA.operations.filter((one) => one.family === $("operation-family").value && one.direction === $("operation-direction").value
      && one.sequence === $("operation-sequence").value);
    const bars = [...new Set(chosen.map((one) => one.bar))];
    const stages = [...new Set(chosen.map((one) => one.stage))];
    draw("operation-bars", stages.map((stage, i) => ({
      name: stage, type: "bar", orientation: "h", y: bars, marker: { color: COLOURS[i % COLOURS.length] },
      x: bars.map((bar) => chosen.filter((one) => one.bar === bar && one.stage === stage).reduce((sum, one) => sum + one.value, 0)),
      hovertemplate: `${stage}: %{x:.4s} operations<extra>%{y}</extra>`,
    })), { barmode: "stack", xaxis: { title: { text: "operations a frame" } }, yaxis: { automargin: true, autorange: "reversed" },
      height: Math.max(320, 90 + 26 * bars.length) });
  };
  for (const id of ["operation-family", "operation-direction", "operation-sequence"]) $(id).addEventListener("change", plot);
  plot();
}

/* The table: sortable, searchable, downloadable. */
function table() {
  const fixed = ["sequence", "codec", "setting"];
  const columns = [...fixed, ...Object.keys(DATA.columns), "status", "reason"];
  let order = null, up = true;
  const text = new Set([...fixed, "status", "reason"]);
  const visible = () => {
    const words = $("search").value.toLowerCase().split(/\s+/).filter(Boolean);
    const rows = DATA.rows.filter((row) => words.every((word) => `${row.sequence} ${row.codec} ${row.setting} ${row.status}`.toLowerCase().includes(word)));
    if (order) rows.sort((a, b) => (up ? 1 : -1) * (text.has(order) ? String(a[order]).localeCompare(String(b[order])) : number(a[order]) - number(b[order])));
    return rows;
  };
  const brief = () => $("all-columns").checked ? columns : columns.filter((name) => text.has(name) || DATA.brief.includes(name));
  const build = () => {
    const names = brief();
    const head = document.createElement("tr");
    for (const name of names) {
      const cell = document.createElement("th");
      cell.textContent = columnName(name) + (name === order ? (up ? " ▲" : " ▼") : "");
      cell.className = text.has(name) ? "text" : ""; cell.scope = "col"; cell.tabIndex = 0;
      cell.setAttribute("aria-sort", name === order ? (up ? "ascending" : "descending") : "none");
      const sort = () => { up = order === name ? !up : true; order = name; build(); };
      cell.addEventListener("click", sort);
      cell.addEventListener("keydown", (event) => { if (event.key === "Enter") sort(); });
      head.append(cell);
    }
    $("table-head").replaceChildren(head);
    $("table-body").replaceChildren(...visible().map((row) => {
      const line = document.createElement("tr");
      for (const name of names) {
        const cell = document.createElement("td");
        cell.textContent = text.has(name) ? row[name] ?? "" : shown(row[name]);
        cell.className = name === "reason" ? "text wrap" : text.has(name) ? "text" : "";
        line.append(cell);
      }
      return line;
    }));
  };
  const download = (name, type, content) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([content], { type }));
    link.download = name; link.click(); URL.revokeObjectURL(link.href);
  };
  const quoted = (value) => /[",\n]/.test(String(value ?? "")) ? `"${String(value).replaceAll('"', '""')}"` : String(value ?? "");
  $("csv").addEventListener("click", () => download(`${DATA.name}.csv`, "text/csv",
    [columns, ...DATA.rows.map((row) => columns.map((name) => row[name]))].map((row) => row.map(quoted).join(",")).join("\n")));
  $("json").addEventListener("click", () => download(`${DATA.name}.json`, "application/json", JSON.stringify(DATA.rows, null, 1)));
  $("search").addEventListener("input", build);
  $("all-columns").addEventListener("change", build);
  build();
}

const everything = () => { for (const part of [curves, trajectories, frames, operations, table]) part(); };
everything();
dark.addEventListener("change", () => location.reload());

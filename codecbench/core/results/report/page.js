"use strict";
const DATA = JSON.parse(document.getElementById("data").textContent);
DATA.rows = DATA.table.sequence.map((_, i) => Object.fromEntries(Object.entries(DATA.table).map(([name, values]) => [name, values[i]])));
const dark = matchMedia("(prefers-color-scheme: dark)");
const curveNames = [...new Set(DATA.rows.map((row) => row.curve))];
const baseline = (codec) => DATA.baselines.includes(codec);
const $ = (id) => document.getElementById(id);
const number = (value) => typeof value === "number" ? value : value === "inf" ? Infinity : NaN;
const shown = (x) => {
  if (Number.isNaN(x)) return "–";
  if (!Number.isFinite(x)) return "∞";
  return x === 0 ? "0" : Math.abs(x) >= 1e5 ? x.toExponential(3) : String(Number(x.toPrecision(4)));
};

/* Text that the drawings would otherwise take for markup. */
const plain = (text) => String(text ?? "").replaceAll("&", "&amp;").replaceAll("<", "&lt;");

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
/* Columns of the table, with what the evaluators say of them; values are shown in the unit of the label. */
const columnName = (column) => (DATA.columns[column] || {}).label || column;
const measured = (row, column) => number(row[column]) * ((DATA.columns[column] || {}).factor ?? 1);
function fillColumns(select, chosen) {
  const groups = new Map();
  for (const [column, facts] of Object.entries(DATA.columns)) {
    if (!groups.has(facts.group)) {
      const group = document.createElement("optgroup");
      group.label = facts.group;
      groups.set(facts.group, group);
      select.append(group);
    }
    const option = new Option(facts.label, column, false, column === chosen);
    option.title = `${column}: ${facts.summary}`;
    groups.get(facts.group).append(option);
  }
}

/* Curves: any column against any other. */
function curves() {
  const columns = Object.keys(DATA.columns);
  fillColumns($("x"), columns[0]);
  fillColumns($("y"), columns[1] || columns[0]);
  fill($("sequence"), DATA.sequences, DATA.sequences[0]);
  fill($("preset"), DATA.presets.map((_, i) => i), 0, (i) => DATA.presets[i].title);
  const rescale = (axis) => { $(`log${axis}`).checked = (DATA.columns[$(axis).value] || {}).scale === "log"; };
  const apply = () => {
    const preset = DATA.presets[$("preset").value];
    if (!preset) return;
    $("x").value = preset.x; $("y").value = preset.y;
    for (const axis of ["x", "y"]) rescale(axis);
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
    const traces = curveNames.map((curve) => {
      const rows = DATA.rows.filter((row) => row.curve === curve && row.sequence === sequence
        && Number.isFinite(measured(row, x)) && Number.isFinite(measured(row, y)))
        .sort((a, b) => measured(a, x) - measured(b, x));
      const style = DATA.styles[curve];
      const bars = (column) => {
        const [low, high] = DATA.intervals[column] || [];
        if (!low) return undefined;
        return { type: "data", symmetric: false, thickness: 1, array: rows.map((r) => measured(r, high) - measured(r, column)),
          arrayminus: rows.map((r) => measured(r, column) - measured(r, low)) };
      };
      return { name: plain(curve), x: rows.map((r) => measured(r, x)), y: rows.map((r) => measured(r, y)),
        text: rows.map((r) => plain(r.setting)), mode: "lines+markers", type: "scatter", error_y: bars(y), error_x: bars(x),
        line: { color: style.colour, width: 1.6 }, marker: { symbol: style.symbol, size: 9, color: style.colour },
        hovertemplate: `<b>${plain(curve)}</b> %{text}<br>${plain(columnName(x))} %{x:.5g}<br>${plain(columnName(y))} %{y:.5g}<extra></extra>` };
    }).filter((trace) => trace.x.length);
    const front = $("front").checked ? frontOf(traces, x, y) : [];
    if (front.length) traces.push({ name: "Pareto front", x: front.map((p) => p[0]), y: front.map((p) => p[1]), mode: "lines",
      type: "scatter", line: { color: "#8a8f98", width: 8 }, opacity: 0.35, hoverinfo: "skip" });
    const left = DATA.rows.filter((row) => row.sequence === sequence && !(Number.isFinite(measured(row, x)) && Number.isFinite(measured(row, y))));
    $("left-out").textContent = left.length
      ? `Without a finite value here: ${left.map((r) => `${r.codec} ${r.setting}`.trim()).join("; ")}.` : "";
    draw("curve", traces, {
      showlegend: true,
      xaxis: { title: { text: plain(columnName(x)) }, ...scale($("logx").checked) },
      yaxis: { title: { text: plain(columnName(y)) }, ...scale($("logy").checked) },
    });
  };
  for (const axis of ["x", "y"]) $(axis).addEventListener("change", () => { rescale(axis); plot(); });
  for (const id of ["sequence", "logx", "logy", "front"]) $(id).addEventListener("change", plot);
  $("preset").addEventListener("change", apply);
  if (!DATA.presets.length) $("preset").parentElement.remove();
  if (DATA.presets.length) apply(); else if (columns.length) plot();
}

/* Maps: small multiples of the drawings that an evaluator made of what its cells left. */
function map(view, id) {
  const part = (name) => $(`${id}-${name}`);
  const sequences = [...new Set(view.drawings.map((drawing) => drawing.sequence))];
  fill(part("sequence"), sequences, sequences[0]);
  const names = [...new Set(view.drawings.map((drawing) => drawing.codec))];
  const few = view.drawings.filter((drawing) => drawing.sequence === sequences[0]).length <= 12;
  const all = "all codecs";
  fill(part("codec"), [all, ...names], few ? all : names.find((name) => !baseline(name)) || all);
  const plot = () => {
    const host = part("multiples");
    for (const old of host.querySelectorAll(".plot")) Plotly.purge(old);
    host.replaceChildren();
    const codec = part("codec").value;
    const chosen = view.drawings.filter((drawing) => drawing.sequence === part("sequence").value
      && (codec === all || drawing.codec === codec || baseline(drawing.codec)));
    chosen.forEach((drawing, i) => {
      const box = document.createElement("div");
      const caption = document.createElement("figcaption");
      caption.textContent = `${drawing.codec} ${drawing.setting}`.trim() + ` — ${drawing.caption}`;
      caption.className = drawing.holds === false ? "bad" : "";
      const plotted = document.createElement("div");
      plotted.className = "plot"; plotted.id = `${id}-${i}`;
      box.append(plotted, caption); host.append(box);
      const traces = drawing.lines.map((line) => {
        const style = DATA.strokes[line.stroke];
        return { name: plain(line.name), x: line.points[0], y: line.points[1], mode: "lines", type: "scatter", hoverinfo: "name",
          line: { color: style.colour, dash: style.plotly_dash, width: style.width } };
      });
      draw(plotted.id, traces, { margin: { l: 34, r: 6, t: 6, b: 26 }, showlegend: false, yaxis: { scaleanchor: "x" } },
        { ...CONFIG, displayModeBar: false });
    });
  };
  for (const name of ["sequence", "codec"]) part(name).addEventListener("change", plot);
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

/* Bars: stages stacked, one bar a setting. */
function bars(view, id) {
  const part = (name) => $(`${id}-${name}`);
  for (const name of ["choice", "direction", "sequence"]) {
    const values = [...new Set(view.parts.map((bar) => bar[name]))];
    fill(part(name), values, values[0]);
  }
  const plot = () => {
    const chosen = view.parts.filter((bar) => ["choice", "direction", "sequence"].every((name) => bar[name] === part(name).value));
    const settings = [...new Set(chosen.map((bar) => bar.setting))];
    const stages = [...new Set(chosen.map((bar) => bar.stage))];
    draw(`${id}-plot`, stages.map((stage, i) => ({
      name: plain(stage), type: "bar", orientation: "h", y: settings.map(plain), marker: { color: DATA.palette[i % DATA.palette.length],
        pattern: { shape: ["", "/", ".", "x"][Math.floor(i / DATA.palette.length) % 4], fillmode: "overlay", fgcolor: "#fff" } },
      x: settings.map((setting) => chosen.filter((bar) => bar.setting === setting && bar.stage === stage)
        .reduce((sum, bar) => sum + bar.value, 0)),
      hovertemplate: `${plain(stage)}: %{x:.4s} ${plain(view.unit)}<extra>%{y}</extra>`,
    })), { barmode: "stack", xaxis: { title: { text: `${plain(view.unit)} a frame` } }, yaxis: { automargin: true, autorange: "reversed" },
      legend: { orientation: "h", y: 1.02, yanchor: "bottom" }, margin: { l: 56, r: 16, t: 90, b: 48 },
      height: Math.max(320, 150 + 26 * settings.length) });
  };
  for (const name of ["choice", "direction", "sequence"]) part(name).addEventListener("change", plot);
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
        cell.textContent = text.has(name) ? row[name] ?? "" : shown(measured(row, name));
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
  /* As in the table's CSV: a text that spreadsheets would take for a formula gets an apostrophe before it. */
  const harmless = (value) => typeof value === "string" && /^[=+@-]/.test(value) && value !== "-inf" ? `'${value}` : String(value ?? "");
  const quoted = (value) => /[",\n]/.test(harmless(value)) ? `"${harmless(value).replaceAll('"', '""')}"` : harmless(value);
  $("csv").addEventListener("click", () => download(`${DATA.name}.csv`, "text/csv",
    [columns, ...DATA.rows.map((row) => columns.map((name) => row[name]))].map((row) => row.map(quoted).join(",")).join("\n")));
  $("json").addEventListener("click", () => download(`${DATA.name}.json`, "application/json", JSON.stringify(DATA.rows, null, 1)));
  $("search").addEventListener("input", build);
  $("all-columns").addEventListener("change", build);
  build();
}

curves();
DATA.map_views.forEach((view, i) => map(view, `map-${i}`));
frames();
DATA.bars_views.forEach((view, i) => bars(view, `bars-${i}`));
table();
dark.addEventListener("change", () => location.reload());

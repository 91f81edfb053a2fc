"use strict";
/* Bars: stages stacked, one bar a setting, with its total. */
function bars(view, id) {
  const part = (name) => $(`${id}-${name}`), parts = ["choice", "direction", "sequence"];
  for (const name of parts) {
    const values = [...new Set(view.parts.map((bar) => bar[name]))];
    fill(part(name), values, values[0]);
    part(name).parentElement.hidden = values.length < 2;
  }
  const stages = [...new Set(view.parts.map((bar) => bar.stage))];
  const paint = (i) => {
    const color = DATA.palette[i % DATA.palette.length], turn = Math.floor(i / DATA.palette.length) % 3;
    return turn ? `repeating-linear-gradient(${turn === 1 ? 45 : 90}deg, ${color} 0 4px, #fff8 4px 6px)` : color;
  };
  const plot = () => {
    const chosen = view.parts.filter((bar) => parts.every((name) => bar[name] === part(name).value));
    const settings = [...new Set(chosen.map((bar) => bar.setting))];
    const of = (setting, stage) => chosen.filter((bar) => bar.setting === setting && bar.stage === stage).reduce((sum, bar) => sum + bar.value, 0);
    const totals = settings.map((setting) => stages.reduce((sum, stage) => sum + of(setting, stage), 0));
    const most = Math.max(...totals, 0), present = stages.filter((stage) => settings.some((setting) => of(setting, stage)));
    part("legend").replaceChildren(...present.map((stage) => {
      const item = element("span", "stage", stage), box = element("i");
      box.style.background = paint(stages.indexOf(stage));
      item.prepend(box);
      return item;
    }));
    part("plot").replaceChildren(...settings.map((setting, row) => {
      const line = element("div", "bar-row"), bar = element("div", "bar");
      for (const stage of present) {
        const value = of(setting, stage);
        if (!value) continue;
        const piece = element("span");
        piece.style.width = `${100 * value / most}%`; piece.style.background = paint(stages.indexOf(stage));
        piece.title = `${stage}: ${shown(value)} ${view.unit}`;
        bar.append(piece);
      }
      line.append(element("span", "bar-name", setting), bar, element("span", "bar-total", `${shown(totals[row])} ${view.unit}`));
      return line;
    }));
  };
  for (const name of parts) part(name).addEventListener("change", plot);
  plot();
}

/* The table: sortable, searchable, downloadable. What is missing always stands last. */
function table() {
  const fixed = ["sequence", "codec", "setting"], last = ["status", "reason", "notes"].filter((name) => name in DATA.table);
  const text = new Set([...fixed, ...last]), columns = [...fixed, ...Object.keys(DATA.columns), ...last];
  let order = columns.includes(STATE.sort) ? STATE.sort : null, up = STATE.down !== "1";
  const compare = (a, b) => {
    if (text.has(order)) return (up ? 1 : -1) * String(a[order]).localeCompare(String(b[order]), undefined, { numeric: true });
    const [x, y] = [number(a[order]), number(b[order])];
    if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
    return x === y ? 0 : (up ? 1 : -1) * (x < y ? -1 : 1);
  };
  const visible = () => {
    const words = $("search").value.toLowerCase().split(/\s+/).filter(Boolean);
    const rows = DATA.rows.filter((row) => words.every((word) => `${row.sequence} ${row.codec} ${row.setting} ${row.status}`.toLowerCase().includes(word)));
    return order ? rows.sort(compare) : rows;
  };
  const names = () => $("all-columns").checked ? columns : columns.filter((name) => text.has(name) || DATA.brief.includes(name));
  const filled = () => {
    const shownNames = names();
    for (const cell of $("table-head").querySelectorAll("th")) {
      const sorted = cell.dataset.name === order;
      cell.setAttribute("aria-sort", sorted ? (up ? "ascending" : "descending") : "none");
      cell.querySelector("span").textContent = sorted ? (up ? " ▲" : " ▼") : "";
    }
    const rows = visible();
    $("table-body").replaceChildren(...rows.map((row) => {
      const line = document.createElement("tr");
      for (const name of shownNames) {
        line.append(element("td", ["reason", "notes"].includes(name) ? "text wrap" : text.has(name) ? "text" : "", text.has(name) ? row[name] ?? "" : shown(measured(row, name))));
      }
      return line;
    }));
    $("found").textContent = rows.length === DATA.rows.length ? `${rows.length} rows` : `${rows.length} of ${DATA.rows.length} rows`;
  };
  const build = () => {
    const head = document.createElement("tr");
    for (const name of names()) {
      const cell = element("th", text.has(name) ? "text" : ""), button = element("button", "sort", columnOf(name).label);
      cell.scope = "col"; cell.dataset.name = name; button.type = "button"; button.append(element("span"));
      button.title = columnOf(name).summary || "";
      button.addEventListener("click", () => { up = order === name ? !up : true; order = name; remember({ sort: order, down: up ? "" : "1" }); filled(); });
      cell.append(button); head.append(cell);
    }
    $("table-head").replaceChildren(head);
    filled();
  };
  const download = (name, type, content) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([content], { type }));
    link.download = name; link.click(); URL.revokeObjectURL(link.href);
  };
  /* As in the table's CSV: a text that spreadsheets would take for a formula gets an apostrophe before it. */
  const harmless = (value) => typeof value === "string" && /^[=+@-]/.test(value) && value !== "-inf" ? `'${value}` : String(value ?? "");
  const quoted = (value) => /[",\n]/.test(harmless(value)) ? `"${harmless(value).replaceAll('"', '""')}"` : harmless(value);
  const plain = () => DATA.rows.map((row) => Object.fromEntries(columns.map((name) => [name, row[name]])));
  $("csv").addEventListener("click", () => download(`${DATA.name}.csv`, "text/csv",
    [columns, ...DATA.rows.map((row) => columns.map((name) => row[name]))].map((row) => row.map(quoted).join(",")).join("\n")));
  $("json").addEventListener("click", () => download(`${DATA.name}.json`, "application/json", JSON.stringify(plain(), null, 1)));
  $("search").addEventListener("input", filled);
  $("all-columns").addEventListener("change", build);
  build();
}

curves();
looking();
DATA.map_views.forEach((view, i) => multiples(view, `map-${i}`));
DATA.bars_views.forEach((view, i) => bars(view, `bars-${i}`));
table();

/* What is wrong with how the page looks, as a list of sentences. */
(() => {
  const faults = [], seen = (node) => node.getClientRects().length && getComputedStyle(node).visibility !== "hidden";
  const box = (node) => node.getBoundingClientRect();
  const meet = (a, b) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1;
  for (const svg of document.querySelectorAll("svg.chart")) {
    if (!seen(svg)) continue;
    const name = svg.getAttribute("aria-label"), around = box(svg);
    if (![...svg.querySelectorAll(".line")].some((line) => line.getAttribute("d")) && !svg.querySelector(".point")) faults.push(`empty: ${name}`);
    for (const axis of ["x", "y"]) {
      const ticks = [...svg.querySelectorAll(`.tick.${axis}`)];
      if (ticks.length < 2 && !svg.closest(".multiple")) faults.push(`${axis} axis with ${ticks.length} numbers: ${name}`);
      ticks.forEach((tick, i) => { if (i && meet(box(tick), box(ticks[i - 1]))) faults.push(`numbers overlap on ${axis}: ${name}`); });
    }
    for (const text of svg.querySelectorAll("text")) {
      const own = box(text);
      if (own.left < around.left - 1 || own.right > around.right + 1 || own.bottom > around.bottom + 1 || own.top < around.top - 1) faults.push(`cut off: ${text.textContent} in ${name}`);
    }
    const legend = svg.closest("section").querySelector(".legend");
    if (legend && seen(legend) && meet(box(legend), around)) faults.push(`legend over ${name}`);
  }
  for (const select of document.querySelectorAll("select")) if (seen(select) && !select.options.length) faults.push(`nothing to select: ${select.id}`);
  for (const part of document.querySelectorAll("main section *")) {
    if (!seen(part) || part.closest(".scroll, pre, .stage, svg, select, .tip")) continue;
    const own = box(part);
    if (own.right > innerWidth + 1 || own.left < -1) faults.push(`beyond the window: ${part.tagName} ${part.id || part.className}`);
  }
  if (document.documentElement.scrollWidth > innerWidth) faults.push(`scrolls sideways: ${document.documentElement.scrollWidth}`);
  return faults;
})()

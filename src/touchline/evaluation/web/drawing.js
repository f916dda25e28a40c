"use strict";
// The field with the true path as a broad line, the estimates as dots, and a marker for each place
function drawPath(svg, data) {
  const { size: [length, width], line_width, lines, discs } = data.field, left = -length / 2, low = -width / 2;
  const carried = new Set(data.gaps), size = length / 60, text = length / 42, drawn = [];
  for (const run of data.runs) {
    if (run.dots) continue;
    let path = "", on = false;
    run.x.forEach((x, i) => {
      if (x != null) path += `${on && !carried.has(i) ? "L" : "M"}${x},${run.y[i]}`;
      on = x != null;
    });
    drawn.push(`<path d='${path}' class='truth' stroke='var(--truth)'/>`);
  }
  const located = data.runs.filter(run => run.dots);
  for (const run of located) {
    const groups = new Map();
    run.dots.forEach((color, i) => {
      if (color && Math.abs(run.x[i]) < 1e4 && Math.abs(run.y[i]) < 1e4)
        groups.set(color, (groups.get(color) || "") + `M${run.x[i].toFixed(2)},${run.y[i].toFixed(2)}h0`);
    });
    for (const [color, path] of groups) drawn.push(`<path d='${path}' class='dots' stroke='var(--${color})'/>`);
    const first = run.dots.findIndex(color => color);
    if (located.length === 1 && first >= 0) drawn.push(`<circle cx='${run.x[first]}' cy='${run.y[first]}' r='0.16' class='first'/>`);
  }
  data.runs.forEach((run, k) => drawn.push(
    `<g id='at-${k}' class='marker ${run.marker}' style='display:none'><circle r='${size}'/><line x2='${2.2 * size}'/></g>`));
  const paint = lines.map(line => "M" + line.join(" ")).join(" "), spots = discs.map(([x, y, d]) => `<circle cx='${x}' cy='${y}' r='${d / 2}' fill='var(--paint)'/>`).join("");
  const ticks = [], tick = (x, y, how, words) => ticks.push(`<text x='${x}' y='${y}' ${how}>${words}</text>`);
  for (let x = Math.ceil(left / 2) * 2; x <= -left; x += 2)
    if (x > left + 1.5 * text && x < -left - 6 * text) tick(x, -low + 1.2 * text, "text-anchor='middle'", x);
  for (let y = Math.ceil(low / 2) * 2; y <= -low; y += 2) tick(left + 0.2 * text, -y + 0.35 * text, "fill='var(--ink)' opacity='0.65'", y);
  tick(-left, -low + 1.2 * text, "text-anchor='end'", "x, y (m)");
  svg.setAttribute("viewBox", `${left} ${low} ${length} ${width + 1.6 * text}`);
  svg.innerHTML = `<g id='metres' transform='scale(1,-1)'><rect x='${left}' y='${low}' width='${length}' height='${width}' fill='var(--carpet)'/>` +
    `<path d='${paint}' fill='none' stroke='var(--paint)' stroke-width='${line_width}' stroke-linecap='square'/>${spots}${drawn.join("")}</g>` +
    `<g font-size='${text}' fill='var(--soft)'>${ticks.join("")}</g>`;
}

// Round values (ms) between the ends of a histogram, on a logarithmic axis or a linear one.
function ticksOf(told) {
  const ticks = [];
  if (told.high > 8 * told.low) {
    for (let k = -3; k < 6; k++) for (const n of told.high > 300 * told.low ? [1] : [1, 2, 5]) ticks.push(n * 10 ** k);
  } else {
    const least = (told.high - told.low) / 7, decade = 10 ** Math.floor(Math.log10(least));
    const step = decade * [1, 2, 5, 10].find(n => n * decade >= 0.999 * least);
    for (let k = Math.ceil(told.low / step); k * step <= told.high; k++) ticks.push(k * step);
  }
  return ticks;
}

function nearest(list, i) {
  let best = 0;
  list.forEach((one, k) => { if (Math.abs(one.row - i) < Math.abs(list[best].row - i)) best = k; });
  return list[best];
}
function escaped(text) { const span = document.createElement("span"); span.textContent = text; return span.innerHTML; }

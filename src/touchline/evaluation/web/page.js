"use strict";
// The page of a run, or of several: one time for the slider, the curves, the place on the path and the image.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = id => document.getElementById(id);
  const css = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const t = data.t, last = t.length - 1, charts = [];
  const wide = () => byId("charts").clientWidth;
  let row = -1, linked = false;

  // ---- curves
  function axis(extra) {
    const stroke = () => css("soft"), grid = { stroke: () => css("grid"), width: 1 };
    return { stroke, grid, ticks: { show: false }, font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", ...extra };
  }
  function at(u, seconds) { return u.valToPos(seconds, "x", true); }
  function drawEvents(u) {
    const c = u.ctx, top = u.bbox.top, high = u.bbox.height;
    c.save(); c.beginPath(); c.rect(u.bbox.left, top, u.bbox.width, high); c.clip();
    for (const event of data.events) {
      c.globalAlpha = event.until === undefined ? 1 : 0.35;
      c.strokeStyle = css("ink"); c.fillStyle = css(event.color || "soft"); c.lineWidth = 1;
      if (event.until !== undefined) c.fillRect(at(u, event.t), top, Math.max(2, at(u, event.until) - at(u, event.t)), high);
      else { c.setLineDash([4, 4]); c.beginPath(); c.moveTo(at(u, event.t), top); c.lineTo(at(u, event.t), top + high); c.stroke(); }
    }
    c.restore();
  }
  function nameEvents(u) {
    const c = u.ctx, ratio = devicePixelRatio || 1, taken = [];
    c.save(); c.fillStyle = css("ink"); c.font = `${12 * ratio}px system-ui, sans-serif`; c.textBaseline = "top"; c.textAlign = "left";
    for (const event of [...data.events].sort((a, b) => (a.until !== undefined) - (b.until !== undefined) || a.t - b.t)) {
      const left = at(u, event.t), right = left + c.measureText(event.label).width + 6 * ratio;
      if (left < u.bbox.left || right > u.bbox.left + u.bbox.width || taken.some(([a, b]) => left < b && right > a)) continue;
      c.fillText(event.label, left, 1); taken.push([left, right]);
    }
    c.restore();
  }
  function options(title, height, series, more) {
    return {
      width: wide(), height, title, series: [{ label: "time", value: (u, v) => v == null ? "–" : v.toFixed(2) + " s" }, ...series],
      cursor: { sync: { key: "time", setSeries: false, scales: ["x", null] }, drag: { x: true, y: false }, y: false },
      legend: { live: true }, ...more,
      hooks: {
        drawClear: [drawEvents], ...more.hooks,
        setCursor: [u => { if (!linked && u.cursor.event && u.cursor.idx != null && u.cursor.left >= 0) show(u.cursor.idx, u); }],
        setScale: [(u, key) => { if (key === "x" && !linked) linkScales(u.scales.x.min, u.scales.x.max, u); }],
      },
    };
  }
  function addStatus() {
    const shown = data.runs.filter(run => run.status), high = 18, names = data.statuses, colors = ["tracking", "searching", "lost"];
    const paint = u => {
      const c = u.ctx, step = u.bbox.height / shown.length;
      c.save(); c.beginPath(); c.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); c.clip();
      shown.forEach((run, k) => {
        for (let a = 0, b; a <= last; a = b) {
          for (b = a + 1; b <= last && run.status[b] === run.status[a]; ) b++;
          if (run.status[a] == null) continue;
          const x = at(u, t[a]);
          c.fillStyle = css(colors[run.status[a]]);
          c.fillRect(x, u.bbox.top + k * step + 1, Math.max(1, at(u, t[Math.min(b, last)]) - x), step - 2);
        }
      });
      c.restore();
    };
    const series = shown.map(run => ({ label: run.name, stroke: "transparent", points: { show: false }, scale: "y",
      value: (u, v, s, i) => i == null || run.status[i] == null ? "–" : names[run.status[i]] }));
    const more = { scales: { x: { time: false }, y: { range: [0, 1] } }, hooks: { draw: [paint, drawEvents, nameEvents] }, padding: [16, 8, 0, 0],
      axes: [axis({ show: false }), axis({ size: 56, label: " ", labelSize: 18, values: () => [], grid: { show: false } })] };
    charts.push(new uPlot(options("", high * shown.length + 22, series, more), [t, ...shown.map(run => run.status.map(() => 0))], byId("charts")));
  }
  function addChart(chart) {
    const value = (u, v) => v == null ? "–" : v.toFixed(chart.digits) + " " + chart.unit, columns = [t], series = [], bands = [];
    const carried = u => data.gaps.map(k => [at(u, t[k - 1]), at(u, t[k])].map(Math.round));
    const gaps = (u, s, i0, i1, found) => [...found, ...carried(u)].sort((a, b) => a[0] - b[0]);
    for (const one of chart.series) {
      series.push({ label: one.label, stroke: () => css(one.color), width: 1.5, value, gaps, points: { show: false } });
      columns.push(one.values);
      if (!one.band) continue;
      const edge = { stroke: "transparent", points: { show: false }, gaps };
      const k = columns.push(one.band.map(v => v), one.band.map(v => v == null ? null : -v)) - 2;
      series.push({ ...edge, label: "± 2σ", value }, { ...edge, label: "", value: () => "", class: "hidden" });
      bands.push({ series: [k, k + 1], fill: () => css(one.color) + "30" });
    }
    const more = { bands, scales: { x: { time: false }, y: { range: chart.range } }, padding: [8, 8, chart.last ? 0 : 7, 0],
      axes: [axis({ show: chart.last === true, label: "time (s)", labelSize: 18, size: 34 }), axis({ size: 56, label: chart.axis, labelSize: 18 })] };
    charts.push(new uPlot(options(chart.title, chart.last ? 190 : 160, series, more), columns, byId("charts")));
  }
  function addHistogram(box, told) {
    const bins = told.later.length, span = Math.log(told.high / told.low), ticks = ticksOf(told);
    const across = ms => bins * Math.min(Math.max(Math.log(ms / told.low) / span, 0), 1);
    const shown = ticks.filter(ms => told.low <= ms && ms <= told.high), names = new Map(shown.map(ms => [across(ms), String(+ms.toPrecision(3))]));
    const mark = u => {
      const c = u.ctx, ratio = devicePixelRatio || 1, right = u.bbox.left + u.bbox.width, [median, p99] = told.marks;
      c.save(); c.fillStyle = c.strokeStyle = css("ink"); c.lineWidth = ratio; c.font = `${12 * ratio}px system-ui, sans-serif`; c.textBaseline = "top";
      const x = one => at(u, across(one.ms)), wide = one => c.measureText(one.label).width;
      for (const one of told.marks) { c.beginPath(); c.moveTo(x(one), u.bbox.top); c.lineTo(x(one), u.bbox.top + u.bbox.height); c.stroke(); }
      const after = Math.min(x(p99) + 4 * ratio, right - wide(p99));  // each label has its room
      c.textAlign = "end"; c.fillText(median.label, Math.max(Math.min(x(median) - 4 * ratio, after - 8 * ratio), u.bbox.left + wide(median)), 2 * ratio);
      c.textAlign = "start"; c.fillText(p99.label, after, 2 * ratio);
      c.restore();
    };
    const bars = uPlot.paths.bars({ size: [1, Infinity], gap: 0 }), bar = color => ({ paths: bars, points: { show: false }, width: 0, fill: () => css(color) });
    const all = told.later.map((count, k) => count + told.first[k]), numbers = { show: true, grid: { stroke: () => css("grid"), width: 1 } };
    const u = new uPlot({
      width: box.clientWidth, height: 260, padding: [20, 8, 0, 0], legend: { show: false }, cursor: { show: false },
      series: [{}, bar("soft"), bar("bar")], scales: { x: { time: false, range: [0, bins] }, y: { range: (u, low, high) => [0, 1.05 * Math.max(high, 1)] } },
      axes: [axis({ ...numbers, splits: () => [...names.keys()], values: (u, splits) => splits.map(x => names.get(x)), label: "time per frame (ms)", labelSize: 18, size: 34 }),
        axis({ ...numbers, size: 56, incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1e3, 2e3, 5e3, 1e4, 2e4, 5e4, 1e5], label: "frames", labelSize: 18 })],
      hooks: { draw: [mark] },
    }, [all.map((count, k) => k + 0.5), all, told.later], box);
    new ResizeObserver(() => { if (u.width !== box.clientWidth) u.setSize({ width: box.clientWidth, height: u.height }); }).observe(box);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => u.redraw());
  }
  function linkScales(min, max, from) {
    linked = true;
    for (const u of charts) if (u !== from) u.setScale("x", { min, max });
    linked = false;
  }
  function zoom(factor) {
    const { min, max } = charts[0].scales.x, half = factor ? factor * (max - min) / 2 : Infinity;
    const low = Math.max(t[0], t[row] - half), high = Math.min(t[last], t[row] + half);
    if (high > low) { charts[0].setScale("x", { min: low, max: high }); later(); }
  }

  // ---- one time for all
  function place(from) {
    linked = true;
    for (const u of charts) if (u !== from) u.setCursor({ left: u.valToPos(t[row], "x"), top: 10 }, false, false);
    linked = false;
  }
  function later() { requestAnimationFrame(() => place(null)); }  // when the charts have been laid out
  function show(i, from) {
    if (i === row) return;
    byId("time").value = row = i;
    place(from);
    const said = [`<strong>${t[i].toFixed(2)} s</strong>`];
    data.runs.forEach((run, k) => {
      const marker = byId("at-" + k), known = run.x[i] != null;
      marker.style.display = known ? "" : "none";
      if (!known) return;
      marker.setAttribute("transform", `translate(${run.x[i]} ${run.y[i]}) rotate(${run.h[i]})`);
      const name = run.status && data.statuses[run.status[i]], why = name && run.reasons[run.reason[i]];
      const status = name ? `, <span class="key ${name}"></span>${name}${why ? ": " + escaped(why) : ""}` : "";
      said.push(`${escaped(run.name)}: x ${run.x[i].toFixed(2)} m, y ${run.y[i].toFixed(2)} m, heading ${run.h[i].toFixed(1)}°${status}`);
    });
    byId("said").innerHTML = said.join("<br>");
    if (!data.pictures.length) return;
    const picture = nearest(data.pictures, i);
    if (byId("frame").dataset.row === String(picture.row)) return;
    byId("frame").src = "data:image/jpeg;base64," + picture.jpeg;
    byId("frame").dataset.row = picture.row;
    byId("frame-time").textContent = `image at ${t[picture.row].toFixed(2)} s`;
  }

  // ---- hands
  function onPath(event) {
    const svg = byId("path"), point = new DOMPoint(event.clientX, event.clientY).matrixTransform(byId("metres").getScreenCTM().inverse());
    let best = -1, near = 0.5 + svg.viewBox.baseVal.width / 60;
    for (const run of data.runs) run.x.forEach((x, i) => {
      const far = x == null ? Infinity : Math.hypot(x - point.x, run.y[i] - point.y) + 1e-4 * Math.abs(i - row);
      if (far < near) { near = far; best = i; }
    });
    if (best >= 0) show(best, null);
  }
  let playing = 0;
  function play() {
    clearInterval(playing);
    byId("play").textContent = playing ? "Play" : "Pause";
    if (playing) { playing = 0; return; }
    if (row >= last) show(0, null);
    const began = performance.now(), from = t[row];
    playing = setInterval(() => {
      const now = from + (performance.now() - began) / 1000;
      let i = row;
      while (i < last && t[i + 1] <= now) i++;
      show(i, null);
      if (i >= last) play();
    }, 50);
  }
  byId("time").max = last;
  byId("time").addEventListener("input", event => show(Number(event.target.value), null));
  byId("play").addEventListener("click", play);
  byId("zoom-in").addEventListener("click", () => zoom(0.5));
  byId("zoom-out").addEventListener("click", () => zoom(2));
  byId("zoom-all").addEventListener("click", () => zoom(0));
  if (byId("path")) for (const kind of ["click", "mousemove"]) byId("path").addEventListener(kind, onPath);
  if (byId("path")) drawPath(byId("path"), data);
  addStatus();
  data.charts.forEach(addChart);
  if (data.histogram && byId("histogram")) addHistogram(byId("histogram"), data.histogram);
  new ResizeObserver(() => charts.forEach(u => { if (u.width !== wide()) u.setSize({ width: wide(), height: u.height }); later(); })).observe(byId("charts"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach(u => u.redraw()));
  document.documentElement.classList.add("live");
  show(Math.min(data.start, last), null);
  later();
})();

// One chart of lines: axes, bands, the values under the pointer. uPlot draws; what is read aloud and moved by keys is ours.

// Fill `place` with a chart. `told` is a function that gives what is drawn now:
// {x, lines: [{method, y, low, high}], xName, yName, xLog, yLog, yRange, reversed, stepped, marks, label}.
function chart(place, told) {
  let plot = null;
  let asked = null;
  const box = make("div", { class: "plot" });
  const tip = make("div", { class: "tip", role: "status", "aria-live": "polite", hidden: true });
  const frame = make("div", { class: "frame", tabindex: "0", role: "group", onkeydown: keys }, box, tip);
  const note = make("p", { class: "why empty", hidden: true });
  place.replaceChildren(frame, note);

  function draw() {
    const width = Math.floor(place.clientWidth);
    if (!width) return;
    asked = told();
    frame.setAttribute("aria-label", `${asked.label}. Left and right arrow keys read the values.`);
    plot?.destroy();
    plot = null;
    tip.hidden = true;
    const empty = asked.empty || (asked.lines.some((line) => line.y.some((v) => v != null)) ? "" : "Nothing to draw: no method that is chosen has a value here.");
    note.textContent = empty;
    note.hidden = !empty;
    frame.hidden = !!empty;
    if (empty) return;
    const style = getComputedStyle(document.documentElement);
    const ink = printing ? "#1a1a1a" : style.getPropertyValue("--ink").trim();
    const grid = printing ? "#ddd" : style.getPropertyValue("--line").trim();
    const values = [asked.x];
    const series = [{}];
    const bands = [];
    for (const line of asked.lines) {
      const stroke = colour(line.method);
      const paths = asked.stepped ? uPlot.paths.stepped({ align: 1 }) : undefined;
      if (line.low) {
        const at = series.length;
        for (const edge of [line.high, line.low]) {
          values.push(edge);
          series.push({ stroke: "transparent", width: 0, points: { show: false }, spanGaps: false, paths });
        }
        bands.push({ series: [at, at + 1], fill: stroke + "2a" });
      }
      values.push(line.y);
      series.push({ stroke, width: 2, dash: dash(line.method), label: data.methods[line.method].name, spanGaps: !!asked.spanGaps,
        points: { show: !!asked.points, size: 5, fill: stroke, stroke }, paths, method: line.method });
    }
    const axis = (name, log, size, most) => ({ stroke: ink, label: name, labelSize: 20, size, font: "12px system-ui, sans-serif",
      labelFont: "12px system-ui, sans-serif", grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1 },
      values: (_, ticks) => ticks.map((v) => (v == null ? "" : text(v, 3))),
      // uPlot looks for a step between ticks among its own, finds none for 1e299, and then leaves out all labels
      ...(log ? { incrs: (_, i, low, high) => [high - low], splits: (_, i, low, high) => steps(low, high, most), filter: (_, splits) => splits } : { space: 46 }) });
    plot = new uPlot({
      width, height: Math.round(Math.min(340, Math.max(230, width * 0.55))), legend: { show: false }, padding: [10, 24, 0, 0],
      cursor: { drag: { setScale: false, x: false, y: false }, focus: { prox: 24 }, points: { size: 7 } }, focus: { alpha: 0.35 },
      scales: {
        x: { time: false, distr: asked.xLog ? 3 : 1, dir: asked.reversed ? -1 : 1, range: ends(asked.x, asked.xLog) },
        y: { distr: asked.yLog ? 3 : 1, ...(asked.yRange ? { range: asked.yRange } : {}) },
      },
      axes: [axis(asked.xName, asked.xLog, 40, width / 62), axis(asked.yName, asked.yLog, 62, 8)],
      series, bands,
      hooks: { setCursor: [show], draw: [marks] },
    }, values, box);
  }

  function marks(u) {
    for (const mark of asked.marks || []) {
      const at = u.valToPos(mark, "x", true);
      u.ctx.save();
      u.ctx.strokeStyle = getComputedStyle(document.documentElement).getPropertyValue("--soft").trim();
      u.ctx.setLineDash([4, 4]);
      u.ctx.beginPath();
      u.ctx.moveTo(at, u.bbox.top);
      u.ctx.lineTo(at, u.bbox.top + u.bbox.height);
      u.ctx.stroke();
      u.ctx.restore();
    }
  }

  function show(u) {
    const i = u.cursor.idx;
    if (i == null || u.cursor.left < 0) {
      tip.hidden = true;
      return;
    }
    const rows = asked.lines.filter((line) => line.y[i] != null).sort((a, b) => b.y[i] - a.y[i]);
    const more = rows.length > 12 ? make("p", {}, `and ${rows.length - 12} more`) : null;
    tip.replaceChildren(
      make("b", {}, `${asked.xName.replace(/ \[.*/, "")} ${text(asked.x[i])}`),
      make("ul", {}, ...rows.slice(0, 12).map((line) => make("li", {}, swatch(line.method), ` ${data.methods[line.method].name}: ${asked.told(line, i)}`))),
      ...(more ? [more] : []),
    );
    tip.hidden = !rows.length;
    const right = u.cursor.left > u.over.clientWidth / 2;
    tip.style.left = right ? "" : `${u.over.offsetLeft + u.cursor.left + 14}px`;
    tip.style.right = right ? `${frame.clientWidth - u.over.offsetLeft - u.cursor.left + 14}px` : "";
    tip.style.top = `${u.over.offsetTop + 4}px`;
  }

  function keys(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1, Home: -Infinity, End: Infinity }[event.key];
    if (event.key === "Escape" && plot) plot.setCursor({ left: -10, top: -10 });
    if (step === undefined || !plot) return;
    event.preventDefault();
    const now = plot.cursor.idx == null || plot.cursor.left < 0 ? (step > 0 ? -1 : asked.x.length) : plot.cursor.idx;
    const next = Math.max(0, Math.min(asked.x.length - 1, now + (asked.reversed ? -step : step)));
    plot.setCursor({ left: plot.valToPos(asked.x[next], "x"), top: 10 });
  }

  let before = 0;
  new ResizeObserver(() => {
    const width = Math.floor(place.clientWidth);
    if (width !== before) {
      before = width;
      draw();
    }
  }).observe(place);
  return draw;
}

// How values are drawn on a logarithmic axis, 0 below all others and none below 0, and its ends, whole powers of ten.
function logarithmic(values) {
  const least = Math.max(1e-307, Math.min(...values.filter((v) => v > 0)) / 10);
  const drawn = (row) => row.map((v) => (v > 0 ? v : v === 0 ? least : null));
  const seen = drawn(values).filter((v) => v != null);
  const power = (v, round) => Math.min(Number.MAX_VALUE, Math.max(1e-307, 10 ** round(Math.log10(v))));
  const span = seen.length ? [Math.min(...seen), Math.max(...seen)] : [0, 1];
  return { drawn, yRange: [power(span[0], (p) => Math.floor(p - 1e-9)), power(span[1], (p) => Math.ceil(p + 1e-9))] };
}

// The first and the last of the values that are on an axis.
function ends(values, log) {
  const seen = values.filter((v) => !log || v > 0);
  return [seen[0], seen[seen.length - 1] > seen[0] ? seen[seen.length - 1] : seen[0] * 2 || 1];
}

// The values at a logarithmic axis: powers of ten, not more than `most`, with 2 and 5 between them where there is room.
function steps(low, high, most) {
  const first = Math.floor(Math.log10(low) + 1e-9);
  const last = Math.min(308, Math.ceil(Math.log10(high) - 1e-9));
  const every = Math.max(1, Math.ceil((last - first) / most));
  const between = (last - first) * 3 <= most ? [1, 2, 5] : [1];
  const found = [];
  for (let power = Math.ceil(first / every) * every; power <= last; power += every) for (const digit of between) found.push(digit * 10 ** power);
  return found.filter((v) => v >= low * (1 - 1e-9) && v <= high * (1 + 1e-9));
}

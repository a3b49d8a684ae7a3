// A run's curve, and a sweep that is followed. Charts are those of the report's page.
const redraws = [];
prefersDark.addEventListener("change", () => { for (const draw of redraws) draw(); });

// An axis for values: logarithmic where none is negative.
function axisOf(values) {
  if (values.some((v) => v < 0) || !values.some((v) => v > 0)) return { yLog: false, drawn: (y) => y };
  return { yLog: true, ...logarithmic(values) };
}

const curve = document.getElementById("curve");
if (curve && data.curve) {
  const { x, y } = data.curve;
  const { drawn, ...axis } = axisOf(y);
  redraws.push(chart(curve, () => ({
    x, xName: "charged evaluations [count]", yName: "best value", xLog: true, ...axis, stepped: true, label: "Best value over charged evaluations",
    lines: [{ method: 0, y: drawn(y) }], told: (line, i) => text(y[i], 4),
  })));
}

const place = document.getElementById("curves");
if (place) follow();

function follow() {
  const find = (id) => document.getElementById(id);
  const cells = new Map(); // "problem\nmethod" -> {problem, method, runs, y}
  let at = [];
  let running = [];
  const numberOf = (name) => {
    const found = data.methods.findIndex((one) => one.name === name);
    return found >= 0 ? found : data.methods.push({ name }) - 1;
  };
  const draw = chart(place, () => {
    const problem = find("problem").value;
    const mine = [...cells.values()].filter((one) => one.problem === problem);
    const now = running.filter((one) => one.problem === problem && one.y.some((v) => v != null));
    const lines = [
      ...mine.map((one) => ({ method: numberOf(one.method), y: one.y, said: `median of ${one.runs}` })),
      ...now.map((one) => ({ method: numberOf(one.method), y: one.y, said: `run ${one.run_id.slice(0, 4)}, in progress` })),
    ];
    const { drawn, ...axis } = axisOf(lines.flatMap((line) => line.y));
    return {
      x: at, xName: "charged evaluations [count]", yName: "best value", xLog: true, ...axis, stepped: true, label: `${problem}: best value over charged evaluations`,
      lines: lines.map((line) => ({ ...line, y: drawn(line.y), values: line.y })), spanGaps: true, empty: lines.length ? "" : "No run has a value yet.",
      told: (line, i) => `${text(line.values[i])} (${line.said})`,
    };
  });
  redraws.push(draw);
  find("problem").addEventListener("change", () => { legend(); draw(); });

  function legend() {
    const problem = find("problem").value;
    const names = new Set([...cells.values(), ...running].filter((one) => one.problem === problem).map((one) => one.method));
    find("legend").replaceChildren(...[...names].map((name) => make("span", { class: "entry" }, swatch(numberOf(name)), ` ${name}`)));
  }

  function list(id, title, heads, rows) {
    find(id).replaceChildren(...(rows.length ? [make("h2", {}, title), make("div", { class: "scroll" }, make("table", {}, make("thead", {}, make("tr", {}, ...heads.map((h) => make("th", {}, h)))),
      make("tbody", {}, ...rows.map((row) => make("tr", {}, ...row.map((one) => make("td", { class: typeof one === "number" ? "n" : null }, one)))))))] : []));
  }

  function show(told) {
    if (told.error) {
      find("words").textContent = told.error;
      find("answer").className = "answer undecided";
      return;
    }
    if (told.at) {
      at = told.at;
      cells.clear();
    }
    for (const one of told.curves) cells.set(`${one.problem}\n${one.method}`, one);
    running = told.running;
    const names = [...new Set([...cells.values(), ...running].map((one) => one.problem))].sort();
    const select = find("problem");
    if (names.join("\n") !== [...select.options].map((one) => one.value).join("\n")) {
      const before = select.value;
      select.replaceChildren(...names.map((name) => make("option", { value: name }, name)));
      if (names.includes(before)) select.value = before;
    }
    find("words").textContent = told.words;
    find("answer").className = `answer ${{ running: "decided", done: "decided" }[told.status] || "undecided"}`;
    const badge = document.querySelector("h1 .state");
    badge.textContent = told.status;
    badge.className = `v state ${told.status}`;
    find("bar").max = told.planned || 1;
    find("bar").value = told.done;
    const facts = [[told.done, "done"], [told.failed, "failed", told.failed], [told.timeouts, "out of time", told.timeouts], [told.left, "left"], [told.pace, "pace"], [told.eta, "to its end"]];
    find("counts").replaceChildren(...facts.map(([value, what, bad]) => make("div", { class: bad ? "bad" : null, "data-what": what }, make("b", {}, String(value)), make("span", {}, what))));
    list("running", "Runs in progress", ["run", "how far"], told.running.map((one) => [one.run_id.slice(0, 8), one.line]));
    list("cells", "What is left", ["runs", "of"], told.cells);
    list("reasons", "Did not end well", ["runs", "how", "why", "one of them"], told.reasons.map(([n, how, why, id]) => [n, how, why, make("a", { href: find("reasons").dataset.runs + encodeURIComponent(id) }, id.slice(0, 8))]));
    legend();
    draw();
  }

  const events = new EventSource(place.dataset.events);
  events.onmessage = (event) => show(JSON.parse(event.data));
  events.onerror = () => { find("words").textContent = "`bench ui` does not answer: it has been stopped, or this browser waits for it"; find("answer").className = "answer undecided"; };
}

// What each chart and table shows, out of `data` and `state`.
const evaluations = () => `evaluations${state.each ? " / parameter" : ""}`;
const quantity = () => data.quantities[state.quantity];

function targetText(q, t, problems = shown("problems")) {
  if (q.key === "goal") {
    const goals = goalsOf(problems);
    return goals.length === 1 ? `the goal ${goals[0]}` : "the goal of each problem";
  }
  if (q.key === "noise") return "the noise of the readings";
  return `${q.name} ≤ ${text(q.targets[t])}${q.unit ? ` ${q.unit}` : ""}`;
}

function goalsOf(problems) {
  return [...new Set(problems.map((p) => data.problems[p].goal).filter(Boolean))];
}

// Those of `problems` on which all methods were run that are shown; all where there are none, and then each has its own.
function common(problems) {
  const methods = shown("methods").filter((m) => problems.some((p) => cell(p, m) !== undefined));
  const found = problems.filter((p) => methods.every((m) => cell(p, m) !== undefined));
  return found.length ? found : problems;
}

// The share of (run, target) pairs that a method reached, a list over the costs: the mean over those of `problems` on
// which it was run.
function shares(method, problems, q) {
  const sum = new Array(data.costs.length).fill(0);
  let count = 0;
  for (const p of problems) {
    const every = data.methods.map((_, m) => cell(p, m)).filter((c) => c !== undefined);
    const c = cell(p, method);
    if (c === undefined || !every.some((one) => q.share[one])) continue; // not run there, or no such targets
    count += 1;
    const mine = q.share[c];
    if (!mine) continue;
    const scale = state.each ? data.problems[p].parameters : 1;
    let at = -1;
    for (let i = 0; i < sum.length; i += 1) {
      while (at + 1 < mine.length && data.costs[at + 1] <= data.costs[i] * scale) at += 1;
      sum[i] += at < 0 ? 0 : mine[at];
    }
  }
  return count ? sum.map((v) => v / count / 1000) : sum.map(() => null);
}

// Runtime ECDF of the chosen methods over some problems.
function ecdf(problems, title) {
  const q = quantity()?.share ? quantity() : data.quantities.find((one) => one.share);
  if (!q) return { empty: "No target is known here that several levels belong to, so there is no curve over targets.", lines: [], x: [], label: title };
  const over = common(problems);
  return {
    x: data.costs, xName: `${evaluations()} [count]`, yName: "share of (run, target) pairs", xLog: state.x === "log", yRange: [0, 1], stepped: true,
    label: `${title}: share of runs and targets (${q.name}) reached, over evaluations`,
    lines: shown("methods").filter((m) => problems.some((p) => cell(p, m) !== undefined)).map((method) => ({ method, y: shares(method, over, q) })),
    told: (line, i) => percent(line.y[i]),
  };
}

// Median and quartiles of the best value on one problem.
function convergence(problem) {
  const about = data.problems[problem];
  const log = state.y === "auto" ? about.scale === "log" : state.y === "log";
  const scale = state.each ? about.parameters : 1;
  const cells = shown("methods").map((method) => [method, cell(problem, method)]).filter(([, c]) => c !== undefined);
  const { drawn, yRange } = log ? logarithmic(cells.flatMap(([, c]) => data.curves[c].flat())) : { drawn: (row) => row };
  const most = Math.max(...cells.map(([, c]) => data.curves[c][0].length));
  const lines = cells.map(([method, c]) => {
    const [middle, low, high] = data.curves[c];
    return { method, y: drawn(middle), low: low && drawn(low), high: high && drawn(high), middle, from: low, to: high };
  });
  return {
    x: data.at.slice(0, most).map((v) => v / scale), xName: `charged ${evaluations()} [count]`, yName: about.axis, xLog: state.x === "log", yLog: log, yRange, lines,
    label: `${about.title}: ${about.axis}, median and quartiles over runs`,
    told: (line, i) => `${text(line.middle[i])}${line.from ? ` (${text(line.from[i])} to ${text(line.to[i])})` : ""}`,
  };
}

// What each target costs on one problem.
function expected(problem) {
  const about = data.problems[problem];
  const q = quantity()?.targets.length > 1 ? quantity() : data.quantities.find((one) => one.targets.length > 1);
  if (!q) return { empty: "No quantity with several targets is known here.", lines: [], x: [], label: about.title };
  const scale = state.each ? about.parameters : 1;
  const ascending = q.targets.map((_, t) => q.targets.length - 1 - t);
  return {
    x: ascending.map((t) => q.targets[t]), xName: `target: ${q.name}${q.unit ? ` [${q.unit}]` : ""}`, yName: `ERT [${evaluations()}]`, xLog: true, yLog: state.x === "log", reversed: true,
    points: true, marks: q === quantity() ? [q.targets[state.target]] : [], label: `${about.title}: expected running time to each target`,
    lines: shown("methods").map((method) => [method, cell(problem, method)]).filter(([, c]) => c !== undefined && q.reached[c]).map(([method, c]) => ({
      method, c, y: ascending.map((t) => (q.ert[c][t] == null ? null : q.ert[c][t] / scale)) })),
    told: (line, i) => `${text(line.y[i])} (${q.reached[line.c][ascending[i]]}/${data.cells.runs[line.c]} runs)`,
  };
}

// Why an interval is wide: too few runs, or too few of them that reached the target.
const WIDE = 10; // from its lower to its upper end
function why(won, runs, low, high) {
  if (high != null && high < WIDE * low) return "";
  return won < runs ? " · wide: not all reached it" : " · wide: runs very unlike";
}

// An interval in words. A lower end of one evaluation is no bound, but of a target that is reached at once.
function span95(low, high, ert, scale) {
  const bounded = low > 1 || ert === 1;
  if (high == null) return bounded ? `${text(low / scale)} – not bounded` : "not bounded";
  return bounded ? `${text(low / scale)} – ${text(high / scale)}` : `at most ${text(high / scale)}`;
}

// The cost of the chosen target in a cell: {told, more, key, won}.
function cost(c) {
  const q = quantity();
  const t = state.target;
  if (c === undefined) return { told: "not run", key: Infinity };
  if (!q.reached[c]) return { told: "no such target", key: Infinity };
  const runs = data.cells.runs[c];
  const won = q.reached[c][t] || 0;
  const scale = state.each ? data.problems[data.cells.problem[c]].parameters : 1;
  const span = data.intervals[`${won}/${runs}`];
  const more = `${won}/${runs} runs${span && runs > 1 ? ` · ${Math.round(span[0] / 10)}–${Math.round(span[1] / 10)} %` : ""}`;
  if (!won) return { told: `> ${text(data.cells.spent[c] / scale)}`, more, key: 1e300 + data.cells.spent[c], won };
  const low = q.low && q.low[c][t];
  const high = q.high && q.high[c][t];
  const range = low != null ? ` [${span95(low, high, q.ert[c][t], scale)}]` : "";
  return { told: text(q.ert[c][t] / scale), range, more: more + (low != null ? why(won, runs, low, high) : ""), key: q.ert[c][t] / scale, won };
}

// A table: a row a problem, a column a method; the lowest cost of a row is bold.
const ROWS = 60;
function costTable(problems, all, showAll) {
  const methods = shown("methods").filter((m) => problems.some((p) => cell(p, m) !== undefined));
  const some = all ? problems : problems.slice(0, ROWS);
  const several = quantity().key === "goal" && goalsOf(problems).length > 1;
  const head = make("tr", {}, make("th", { scope: "col" }, "problem"),
    ...methods.map((m) => make("th", { scope: "col", class: "n" }, swatch(m), " ", parted(data.methods[m].name))));
  const rows = some.map((p) => {
    const costs = methods.map((m) => cost(cell(p, m)));
    const best = Math.min(...costs.map((one) => one.key));
    const goal = several ? data.problems[p].goal : "";
    return make("tr", {}, make("th", { scope: "row" }, parted(data.problems[p].title), goal ? make("small", { class: "under" }, goal) : null), ...costs.map((one) => make("td", { class: "n", "data-sort": one.key },
      make(one.won && one.key === best ? "b" : "span", { class: one.won ? null : "never" }, one.told), one.range ? make("small", {}, one.range) : null,
      one.more ? make("small", { class: "under" }, one.more) : null)));
  });
  const table = make("table", { class: "costs" }, make("caption", {}, `ERT, in ${evaluations()}, to ${targetText(quantity(), state.target)}`),
    make("thead", {}, head), make("tbody", {}, ...rows));
  sortable(table);
  const left = problems.length - some.length;
  return [make("div", { class: "scroll" }, table), left ? make("button", { type: "button", onclick: showAll }, `Show ${left} more problems`) : null].filter(Boolean);
}

// The same of one problem: a row a method.
function problemTable(problem) {
  const methods = shown("methods").filter((m) => cell(problem, m) !== undefined);
  if (!methods.some((m) => quantity().reached[cell(problem, m)])) return make("p", { class: "why" }, "This problem has no such target: choose another one under “What is shown”.");
  const rows = methods.map((m) => {
    const c = cell(problem, m);
    const one = cost(c);
    return make("tr", {}, make("th", { scope: "row" }, swatch(m), " ", parted(data.methods[m].name)),
      make("td", { class: "n", "data-sort": one.key }, make("span", { class: one.won ? null : "never" }, one.told), one.range ? make("small", {}, one.range) : null),
      make("td", { class: "n", "data-sort": one.won === undefined ? 1 : -one.won / data.cells.runs[c] }, ...(one.more || "–").split(" · ").map((part, i) => make(i ? "small" : "span", { class: i ? "under" : null }, part))));
  });
  const heads = ["method", `ERT [${evaluations()}]`, "reached, with 95 % interval"];
  const table = make("table", { class: "methods" }, make("caption", {}, `To ${targetText(quantity(), state.target, [problem])}`),
    make("thead", {}, make("tr", {}, ...heads.map((h, i) => make("th", { scope: "col", class: i ? "n" : null }, h)))), make("tbody", {}, ...rows));
  sortable(table);
  return make("div", { class: "scroll" }, table);
}

// The best methods at the end of the budget, over some problems: a row a method.
function methodTable(problems) {
  const q = quantity();
  const rows = shown("methods").map((m) => {
    const cells = problems.map((p) => cell(p, m)).filter((c) => c !== undefined && q.reached[c]);
    const runs = cells.reduce((sum, c) => sum + data.cells.runs[c], 0);
    const won = cells.reduce((sum, c) => sum + (q.reached[c][state.target] || 0), 0);
    const every = cells.filter((c) => (q.reached[c][state.target] || 0) === data.cells.runs[c]).length;
    const failed = problems.map((p) => cell(p, m)).filter((c) => c !== undefined).reduce((sum, c) => sum + data.cells.failed[c], 0);
    const share = q.share ? shares(m, common(problems), q).at(-1) : null;
    return make("tr", {}, make("th", { scope: "row" }, swatch(m), " ", parted(data.methods[m].name)),
      make("td", { class: "n", "data-sort": runs ? -won / runs : 1 }, runs ? `${won}/${runs}` : "–", runs ? make("small", { class: "under" }, percent(won / runs)) : null),
      make("td", { class: "n", "data-sort": -every }, `${every}/${cells.length}`),
      ...(q.share ? [make("td", { class: "n", "data-sort": share == null ? 1 : -share }, share == null ? "–" : percent(share))] : []),
      make("td", { class: failed ? "n lost" : "n", "data-sort": failed }, failed ? `✗ ${failed}` : "0"));
  });
  const heads = ["method", "runs at the target", "problems where all are", ...(q.share ? ["all targets, at the end"] : []), "failed or out of time"];
  const table = make("table", { class: "methods" }, make("caption", {}, `Success: ${targetText(q, state.target)}`),
    make("thead", {}, make("tr", {}, ...heads.map((h, i) => make("th", { scope: "col", class: i ? "n" : null }, h)))), make("tbody", {}, ...rows));
  sortable(table);
  return make("div", { class: "scroll" }, table);
}

// The final values of one problem, where the page holds no table of them: a row a method.
function finalTable(problem) {
  const rows = shown("methods").map((m) => [m, cell(problem, m)]).filter(([, c]) => c !== undefined).map(([m, c]) => {
    const { median, q1, q3, runs, failed, seconds } = data.cells;
    const number = (v) => make("td", { class: "n", "data-sort": v == null ? Infinity : v }, text(v));
    return make("tr", {}, make("th", { scope: "row" }, swatch(m), " ", parted(data.methods[m].name)), number(median[c]), number(q1[c]), number(q3[c]),
      number(runs[c]), number(failed[c]), number(seconds[c]));
  });
  const heads = ["method", "best, median", "lower quartile", "upper quartile", "runs", "failed or out of time", "seconds, median"];
  const table = make("table", {}, make("caption", {}, data.problems[problem].axis), make("thead", {}, make("tr", {}, ...heads.map((h, i) => make("th", { scope: "col", class: i ? "n" : null }, h)))),
    make("tbody", {}, ...rows));
  sortable(table);
  return make("div", { class: "scroll" }, table);
}

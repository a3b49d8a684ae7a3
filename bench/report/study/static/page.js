// The page comes to life: what needs a script is put in its place, and what is closed is drawn when it is opened.

const PROPOSED = "a hit stands where the answer was proposed, so a longer run may look slower";

function suite(place) {
  const title = make("h2");
  const what = make("p", { class: "why" });
  const curve = make("div", { class: "chart" });
  const success = make("div", {});
  const table = make("div", {});
  let all = false;
  place.append(title, what, make("div", { class: "charts" }, make("figure", {}, make("figcaption", {}, "Runtime ECDF: how much was reached within how many evaluations"), curve)), success, table);
  const draw = chart(curve, () => ecdf(shown("problems"), title.textContent));
  function told() {
    const problems = shown("problems");
    const groups = new Set(problems.map((p) => data.problems[p].group));
    const whole = data.groups.length && groups.size === 1 && data.problems.every((p, i) => !groups.has(p.group) || state.problems.has(i));
    title.textContent = problems.length === data.problems.length ? `All ${problems.length === 1 ? "runs" : `${problems.length} problems`} together`
      : whole ? `Group ${data.groups[[...groups][0]]}` : `${problems.length} of ${data.problems.length} problems together`;
    const q = quantity();
    if (!q) {
      draw();
      return;
    }
    const over = common(problems);
    const own = shown("methods").some((m) => over.some((p) => cell(p, m) === undefined));
    const which = own ? "; no problem was run by all methods that are shown, so each is over its own" : over.length < problems.length ? `; the curves are over the ${over.length} on which all methods were run that are shown` : "";
    const levels = q.share ? q : data.quantities.find((one) => one.share) ?? q;
    const noisy = over.some((p) => data.problems[p].noisy) ? ` Where values are noisy, ${PROPOSED}.` : "";
    what.textContent = `Every problem counts the same${which}. Targets of the curve: ${levels.name}${q.share && q.unit ? ` [${q.unit}]` : ""}.${noisy}`;
    draw();
    success.replaceChildren(methodTable(problems));
    if (data.problems.length > 1) table.replaceChildren(...costTable(problems, all, () => { all = true; told(); }));
  }
  listeners.push(told);
}

// The charts of one problem under one error function, drawn while its section is open.
function problemCharts(section, places) {
  let draws = null;
  function told() {
    if (!section.open) return;
    draws ??= places.map((place) => {
      const p = Number(place.dataset.problem);
      const hits = data.problems[p].noisy ? `; values are noisy: ${PROPOSED}` : "";
      const parts = [
        ["Best value over evaluations: median, band from quartile to quartile", () => convergence(p)],
        [`Runtime ECDF of this problem${hits}`, () => ecdf([p], data.problems[p].title)],
        [`Expected running time (ERT) to each target; dashed: the chosen one${hits}`, () => expected(p)],
      ];
      const charts = parts.map(([caption, what]) => {
        const box = make("div", { class: "chart" });
        return { figure: make("figure", {}, make("figcaption", {}, caption), box), draw: chart(box, what) };
      });
      const table = make("div", {});
      const final = make("div", {});
      if (places.length > 1) place.append(make("h3", {}, data.problems[p].title));
      place.append(make("div", { class: "charts" }, ...charts.map((one) => one.figure)), table, final);
      return () => {
        place.hidden = !state.problems.has(p);
        for (const one of charts) one.draw();
        if (data.quantities.length) table.replaceChildren(problemTable(p));
        if (place.dataset.final) final.replaceChildren(finalTable(p));
      };
    });
    for (const draw of draws) draw();
  }
  listeners.push(told);
  section.addEventListener("toggle", told);
}

// Rows of tables that were made beforehand, by the name of their method.
function rowsOfMethods() {
  const rows = [...document.querySelectorAll("details.problem .scroll tr")].filter((row) => row.cells.length > 1 && !row.closest("thead") && !row.closest(".drawn"));
  listeners.push(() => {
    const names = new Set(shown("methods").map((m) => data.methods[m].plain));
    const known = new Set(data.methods.map((method) => method.plain));
    for (const row of rows) {
      const name = row.cells[0].textContent.trim();
      row.hidden = known.has(name) && !names.has(name);
    }
  });
}

function begin() {
  document.documentElement.classList.add("live");
  for (const table of document.querySelectorAll("main .scroll > table")) sortable(table);
  if (data.cells.runs.length) {
    suite(document.getElementById("suite"));
    for (const section of document.querySelectorAll("details.problem")) {
      const places = [...section.querySelectorAll(".drawn")];
      problemCharts(section, places);
      listeners.push(() => { section.hidden = !places.some((place) => state.problems.has(Number(place.dataset.problem))); });
    }
    rowsOfMethods();
    document.getElementById("controls").append(controls());
  }
  const opened = () => {
    const section = document.getElementById(decodeURIComponent(location.hash.slice(1)))?.closest("details.problem");
    if (section) section.open = true;
  };
  addEventListener("hashchange", opened);
  opened();
  changed();
}
begin();

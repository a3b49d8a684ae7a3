// The choices beside the page: methods and problems on and off, the axes, the targets.

// A list of checkboxes with a search and two buttons that act on what the search shows.
function choice(kind, title, items, mark) {
  const boxes = items.map((item, i) => {
    const input = make("input", { type: "checkbox", onchange: () => {
      if (input.checked) state[kind].add(i);
      else state[kind].delete(i);
      changed();
    } });
    return { item, i, input, label: make("label", { title: item.options || item.title || null }, input, mark ? make("span", { class: "mark" }) : null, parted(item.name || item.title)) };
  });
  const list = make("div", { class: "list" }, ...boxes.map((box) => box.label));
  const count = make("output", { class: "why" });
  const search = make("input", { type: "search", placeholder: "search", "aria-label": `Search ${kind}`, oninput: () => {
    const words = search.value.toLowerCase().split(/\s+/);
    for (const box of boxes) box.label.hidden = !words.every((word) => box.label.textContent.toLowerCase().includes(word));
  } });
  const all = (on) => make("button", { type: "button", onclick: () => {
    for (const box of boxes.filter((one) => !one.label.hidden)) {
      if (on) state[kind].add(box.i);
      else state[kind].delete(box.i);
    }
    changed();
  } }, on ? "all" : "none");
  listeners.push(() => {
    for (const box of boxes) {
      box.input.checked = state[kind].has(box.i);
      if (mark) box.label.querySelector(".mark").replaceChildren(swatch(box.i));
    }
    count.textContent = `${state[kind].size} of ${items.length}`;
  });
  return make("fieldset", {}, make("legend", {}, title, " ", count),
    items.length > 7 ? search : null, items.length > 1 ? make("span", { class: "buttons" }, all(true), all(false)) : null, list);
}

// One of a few, as radio buttons.
function radios(title, name, options, key) {
  return make("fieldset", { class: "row" }, make("legend", {}, title), ...options.map(([value, words]) => {
    const input = make("input", { type: "radio", name, value, onchange: () => { state[key] = value; changed(); } });
    input.checked = state[key] === value;
    return make("label", {}, input, make("span", {}, words));
  }));
}

function targets() {
  if (!data.quantities.length) return null;
  const select = make("select", { "aria-label": "What the targets are in", onchange: () => {
    state.quantity = Number(select.value);
    middle();
    changed();
  } }, ...data.quantities.map((q, i) => make("option", { value: i, title: q.what }, `${q.name}${q.unit ? ` [${q.unit}]` : ""}`)));
  select.value = String(state.quantity);
  const slider = make("input", { type: "range", min: 0, step: 1, "aria-label": "Target", oninput: () => {
    state.target = Number(slider.value);
    changed();
  } });
  const said = make("output", { class: "target" });
  const about = make("p", { class: "why" });
  // A target that tells methods apart: the hardest that some run of a method still reached in half of the problems.
  function middle() {
    const q = quantity();
    const ends = data.problems.map((_, p) => Math.max(0, ...data.methods.map((_m, m) => cell(p, m)).filter((c) => c !== undefined && q.reached[c]).map((c) => q.reached[c].length)));
    const order = ends.sort((a, b) => a - b);
    state.target = Math.max(0, Math.min(q.targets.length, order[Math.floor(order.length / 2)]) - 1);
  }
  middle();
  listeners.push(() => {
    const q = quantity();
    slider.max = q.targets.length - 1;
    slider.value = String(state.target);
    slider.hidden = q.targets.length < 2;
    said.textContent = targetText(q, state.target);
    slider.setAttribute("aria-valuetext", said.textContent);
    const several = data.quantities.filter((one) => one.targets.length > 1).map((one) => one.name);
    about.textContent = `${q.what}.${q.targets.length < 2 && several.length ? ` Choose “${several[0]}” for a slider over many targets.` : ""}`;
  });
  return make("fieldset", {}, make("legend", {}, "Target"), select, slider, said, about);
}

function controls() {
  const each = make("input", { type: "checkbox", onchange: () => { state.each = each.checked; changed(); } });
  const groups = data.groups.length ? make("select", { "aria-label": "Group of problems", onchange: () => {
    const chosen = Number(groups.value);
    state.problems = new Set(data.problems.map((_, i) => i).filter((i) => chosen < 0 || data.problems[i].group === chosen));
    changed();
  } }, make("option", { value: -1 }, "all groups"), ...data.groups.map((name, i) => make("option", { value: i }, name))) : null;
  const problems = choice("problems", "Problems", data.problems, false);
  if (groups) problems.querySelector("legend").after(groups);
  return make("details", { class: "choices", open: matchMedia("(min-width: 70rem)").matches },
    make("summary", {}, "What is shown"), themeButton(), choice("methods", "Methods", data.methods, true), targets(),
    radios("Evaluations axis", "x", [["log", "log"], ["linear", "linear"]], "x"),
    radios("Value axis", "y", [["auto", "as fits"], ["log", "log"], ["linear", "linear"]], "y"),
    make("label", { class: "alone" }, each, make("span", {}, "evaluations per parameter")), problems);
}

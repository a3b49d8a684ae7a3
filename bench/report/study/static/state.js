// What is chosen on the page, and who is told when that changes. Methods and problems are numbers into `data`.
const data = JSON.parse(document.getElementById("numbers").textContent);
const SHOWN_AT_FIRST = 10; // methods: more lines than these are not told apart
const state = {
  methods: new Set(data.methods.map((_, i) => i).slice(0, SHOWN_AT_FIRST)),
  problems: new Set(data.problems.map((_, i) => i)),
  x: "log",
  y: "auto",
  each: false, // evaluations for each parameter
  quantity: 0, // the goal, of which the answer speaks, stands first where there is one
  target: 0,
};
const cellOf = new Map(data.cells.problem.map((p, c) => [`${p} ${data.cells.method[c]}`, c]));
const listeners = [];

function cell(problem, method) {
  return cellOf.get(`${problem} ${method}`);
}

// Tell everybody once, after all that one click changes.
let waiting = false;
function changed() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    for (const listener of listeners) listener();
  });
}

function shown(kind) {
  return [...state[kind]].sort((a, b) => a - b);
}

// A name that breaks after an underscore and in no part of it, but in one that no column has room for.
const ROOM = 20; // letters
function parted(name) {
  const parts = name.split(/(?<=[_ ])/).map((part) => (part.length > ROOM ? part : make("span", { class: "whole" }, part)));
  return make("span", {}, ...parts.flatMap((part, i) => (i ? [make("wbr"), part] : [part])));
}

// Make an element: make("p", {class: "why"}, "text", otherElement). Text is never read as HTML.
function make(tag, given = {}, ...inside) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(given)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value != null) element.setAttribute(key, value);
  }
  element.append(...inside.filter((part) => part != null));
  return element;
}

const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };

// A number in few digits: 0.0123, 12 300, 1.2×10⁻⁸.
function text(value, digits = 3) {
  if (value == null || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return "∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e-3 && size < 1e6) {
    const plain = Number(value.toPrecision(size >= 10 ** digits ? Math.ceil(Math.log10(size + 1)) : digits));
    const [whole, part] = String(plain).split(".");
    return whole.replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f") + (part ? `.${part}` : "");
  }
  const [mantissa, power] = value.toExponential(digits - 1).split("e");
  const raised = [...String(Number(power))].map((c) => RAISED[c]).join("");
  const front = String(Number(mantissa));
  return front === "1" ? `10${raised}` : front === "-1" ? `−10${raised}` : `${front}×10${raised}`;
}

function percent(share) {
  return share > 0 && share < 0.01 ? "<1 %" : share < 1 && share > 0.99 ? ">99 %" : `${Math.round(100 * share)} %`;
}

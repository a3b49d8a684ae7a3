// Colours and dashes of methods, as in the drawings; light and dark.
const COLOURS = {
  light: ["#0072b2", "#d55e00", "#00795a", "#b8558e", "#a86f00", "#2b8cc4", "#000000", "#7f6a00", "#882255", "#332288", "#6b6b6b", "#117733"],
  dark: ["#56a8e0", "#ff8c42", "#2fc89b", "#e69bc6", "#f0b429", "#8fd0f5", "#f2f2f2", "#cdb64c", "#d96a9d", "#9a8ff0", "#a8a8a8", "#6cc287"],
};
const DASHES = [[], [8, 4], [8, 3, 2, 3], [2, 3], [8, 2, 2, 2, 2, 2], [4, 2], [1, 2], [12, 4]];
const prefersDark = matchMedia("(prefers-color-scheme: dark)");
let printing = false;

function isDark() {
  const chosen = document.documentElement.dataset.theme;
  return !printing && (chosen ? chosen === "dark" : prefersDark.matches);
}

function colour(method) {
  const colours = COLOURS[isDark() ? "dark" : "light"];
  return colours[method % colours.length];
}

function dash(method) {
  return DASHES[(method + Math.floor(method / COLOURS.light.length)) % DASHES.length];
}

// The line of a method, for a list.
function swatch(method) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  for (const [key, value] of [["viewBox", "0 0 26 8"], ["class", "swatch"], ["aria-hidden", "true"]]) svg.setAttribute(key, value);
  const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
  const given = { x1: 0, x2: 26, y1: 4, y2: 4, stroke: colour(method), "stroke-width": 3, "stroke-dasharray": dash(method).join(" ") };
  for (const [key, value] of Object.entries(given)) line.setAttribute(key, value);
  svg.append(line);
  return svg;
}

function themeButton() {
  const names = { "": "as the system", light: "light", dark: "dark" };
  const button = make("button", { type: "button", class: "theme", onclick: () => {
    const order = Object.keys(names);
    const now = document.documentElement.dataset.theme || "";
    const next = order[(order.indexOf(now) + 1) % order.length];
    if (next) document.documentElement.dataset.theme = next;
    else delete document.documentElement.dataset.theme;
    say();
    changed();
  } });
  function say() {
    button.textContent = `Colours: ${names[document.documentElement.dataset.theme || ""]}`;
  }
  say();
  prefersDark.addEventListener("change", changed);
  addEventListener("beforeprint", () => { printing = true; for (const listener of listeners) listener(); });
  addEventListener("afterprint", () => { printing = false; changed(); });
  return button;
}

// Keys, search while one types, and two studies to compare. Without this script forms and links do the same.
(function () {
"use strict";
const search = document.querySelector('form.search input[type="search"]');
const place = document.getElementById("rows");
let asked = 0;

async function find() {
  const mine = (asked += 1);
  const address = new URL(location.href);
  address.search = new URLSearchParams(new FormData(search.form));
  const shown = address.href;
  address.searchParams.set("part", "");
  try {
    const answer = await fetch(address, { credentials: "same-origin" });
    const text = await answer.text();
    if (mine !== asked) return; // another letter has been typed since
    place.innerHTML = text; // made by our templates, which escape
    history.replaceState(null, "", shown);
    at = -1;
    pick();
  } catch {
    place.setAttribute("data-stale", "");
  }
}

let at = -1;
const rows = () => [...document.querySelectorAll("table.rows tbody tr")];
function move(step) {
  const all = rows();
  if (!all.length) return;
  at = Math.max(0, Math.min(all.length - 1, at + step));
  all.forEach((row, i) => row.classList.toggle("at", i === at));
  all[at].focus({ preventScroll: true });
  all[at].scrollIntoView({ block: "nearest" });
}

addEventListener("keydown", (event) => {
  const typing = event.target.closest("input:not([type=checkbox]), select, textarea");
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "Escape" && typing) typing.blur();
  if (typing) return;
  if (event.key === "/" && search) {
    event.preventDefault();
    search.focus();
    search.select();
  } else if (event.key === "j" || event.key === "k") move(event.key === "j" ? 1 : -1);
  else if (event.key === "Enter" && event.target.matches("tr")) event.target.querySelector("a")?.click();
});

// Two chosen studies are A and B, in the order in which they were made: the older is A.
function pick() {
  const button = document.getElementById("side");
  if (!button) return;
  const chosen = [...document.querySelectorAll('input[form="compare"]:checked')];
  document.querySelectorAll('input[form="compare"]').forEach((box) => box.removeAttribute("name"));
  chosen.slice(0, 2).reverse().forEach((box, i) => box.setAttribute("name", "ab"[i]));
  button.hidden = chosen.length !== 2;
}
document.addEventListener("change", (event) => { if (event.target.matches('input[form="compare"]')) pick(); });
pick();

if (search && place) {
  let timer = 0;
  search.addEventListener("input", () => { clearTimeout(timer); timer = setTimeout(find, 150); });
  search.form.addEventListener("submit", (event) => { event.preventDefault(); clearTimeout(timer); find(); });
}
})();

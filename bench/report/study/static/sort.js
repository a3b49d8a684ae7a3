// Tables that are sorted by a click on a column's head, or Enter there; a third click brings the first order back.

// What a cell is sorted by: its own key, a share k/n, the first number in it, or its words; nothing comes last.
function keyOf(td) {
  if (!td) return [2, ""];
  if (td.dataset.sort !== undefined) return [0, Number(td.dataset.sort)];
  const words = td.textContent.trim();
  if (words === "" || words === "–") return [2, ""];
  const share = words.match(/(\d+)\/(\d+)/);
  if (share) return [0, -Number(share[1]) / Number(share[2])]; // the largest share first
  const number = words.replace(/[\u202f\s](?=\d{3})/g, "").match(/^[-+−]?\d+(\.\d+)?(e[-+]?\d+)?/i);
  return number && /^[\d\-+−]/.test(words) ? [0, Number(number[0].replace("−", "-"))] : [1, words.toLowerCase()];
}

function compare(a, b) {
  if (a[0] !== b[0]) return a[0] - b[0];
  if (a[0] === 1) return a[1].localeCompare(b[1], "en", { numeric: true });
  return a[1] < b[1] ? -1 : a[1] > b[1] ? 1 : 0;
}

function sortable(table) {
  const heads = [...table.querySelectorAll("thead th")];
  const body = table.tBodies[0];
  if (!body || table.querySelectorAll("tbody tr:not(.part)").length < 2) return;
  const first = [...body.rows];
  heads.forEach((head, column) => {
    const button = make("button", { type: "button", class: "sort", onclick: () => {
      const way = { none: "ascending", ascending: "descending", descending: "none" }[head.getAttribute("aria-sort") || "none"];
      for (const other of heads) other.removeAttribute("aria-sort");
      if (way !== "none") head.setAttribute("aria-sort", way);
      order(way, column);
    } });
    button.append(...head.childNodes);
    head.append(button);
  });

  // Rows are sorted between headings, each under its own.
  function order(way, column) {
    const blocks = [[]];
    for (const row of first) {
      if (row.classList.contains("part")) blocks.push([row]);
      else blocks[blocks.length - 1].push(row);
    }
    for (const block of blocks) {
      const head = block.filter((row) => row.classList.contains("part"));
      const rows = block.filter((row) => !row.classList.contains("part"));
      if (way !== "none") {
        const keyed = rows.map((row) => [keyOf(row.cells[column]), row]);
        const sign = way === "ascending" ? 1 : -1;
        keyed.sort(([a], [b]) => (a[0] === 2 || b[0] === 2 ? a[0] - b[0] : sign * compare(a, b)));
        body.append(...head, ...keyed.map(([, row]) => row));
      } else body.append(...head, ...rows);
    }
  }
}

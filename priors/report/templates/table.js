// Tables: a click on a head sorts by it, the best first; a second click turns that round; a third restores the order.
"use strict";
for (const table of document.querySelectorAll("table.ranking")) {
  const body = table.tBodies[0];
  const original = [...body.rows];
  const heads = [...table.tHead.rows[0].cells];

  const value = (row, column) => {
    const cell = row.cells[column];
    if (cell.dataset.value === undefined) return cell.textContent.trim();
    return cell.dataset.value === "" ? null : Number(cell.dataset.value);
  };

  const compare = (a, b) => {
    if (a === null || b === null) return 0;
    return typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true });
  };

  const sort = (column) => {
    const head = heads[column];
    const first = head.dataset.better === "higher" ? "descending" : "ascending";
    const second = first === "ascending" ? "descending" : "ascending";
    const next = { [first]: second, [second]: "none" }[head.getAttribute("aria-sort")] ?? first;
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    if (next !== "none") head.setAttribute("aria-sort", next);
    const sign = next === "descending" ? -1 : 1;
    const valued = original.filter((row) => value(row, column) !== null);
    const rest = original.filter((row) => value(row, column) === null);
    valued.sort((a, b) => sign * compare(value(a, column), value(b, column)));
    body.append(...(next === "none" ? original : [...valued, ...rest]));
    table.classList.toggle("sorted", next !== "none");
  };

  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => sort(column)));
}

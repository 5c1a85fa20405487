"use strict";
// Click on a heading: sort the ranked rows by it; again: the other way round.
for (const button of document.querySelectorAll("thead button")) {
  button.addEventListener("click", () => {
    const heading = button.parentElement;
    const ascending = heading.getAttribute("aria-sort") !== "ascending";
    for (const other of heading.parentElement.children) other.setAttribute("aria-sort", "none");
    heading.setAttribute("aria-sort", ascending ? "ascending" : "descending");
    const body = heading.closest("table").querySelector("tbody.ranked");
    const rows = [...body.rows].sort((a, b) => {
      const [x, y] = [a, b].map((row) => row.cells[heading.cellIndex].dataset.value);
      if (x === undefined || y === undefined) return (x === undefined) - (y === undefined);
      const order = heading.cellIndex === 0 ? x.localeCompare(y) : x - y;
      return ascending ? order : -order;
    });
    body.append(...rows);
  });
}
// Paper shows everything.
addEventListener("beforeprint", () => {
  for (const details of document.querySelectorAll("details")) details.open = true;
});

"use strict";

/* Tables: a press on a heading sorts by it, a second one turns the order round. What is missing stays last. */
function value(row, column, isNumber) {
  const cell = row.cells[column];
  const text = cell.textContent.trim();
  if (!isNumber) return text === "" || text === "–" ? null : text;
  if (cell.dataset.value !== undefined) return Number(cell.dataset.value);
  const found = text.replaceAll("−", "-").match(/^[[(+]*(-?[\d,]*\.?\d+(?:e[+-]?\d+)?)/i);
  return found ? Number(found[1].replaceAll(",", "")) : null;
}

function sort(heading) {
  const table = heading.closest("table");
  const column = heading.cellIndex;
  const descending = heading.getAttribute("aria-sort") === "ascending";
  for (const other of heading.parentElement.cells) other.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
  const body = table.tBodies[0];
  const rows = [...body.rows];
  /* A column may be set like numbers and hold words alone. */
  const isNumber = heading.classList.contains("number") && rows.some((row) => value(row, column, true) !== null);
  const keyed = rows.map((row) => [value(row, column, isNumber), row]);
  keyed.sort(([a], [b]) => {
    if (a === null || b === null) return (a === null) - (b === null);
    const order = isNumber ? a - b : a.localeCompare(b, "en", { numeric: true });
    return descending ? -order : order;
  });
  body.append(...keyed.map(([, row]) => row));
}

for (const button of document.querySelectorAll("thead button")) {
  button.addEventListener("click", () => sort(button.parentElement));
}

/* Figures: a press enlarges one to the window, another one beyond it; Escape, or Close, leaves. */
const dialog = document.querySelector("dialog");
dialog.addEventListener("close", () => {
  dialog.replaceChildren();
  dialog.classList.remove("closer");
});

for (const button of document.querySelectorAll(".zoom")) {
  button.addEventListener("click", () => {
    const view = document.createElement("div");
    view.className = "view";
    const image = button.querySelector("img").cloneNode();
    image.removeAttribute("width");
    image.addEventListener("click", () => dialog.classList.toggle("closer"));
    view.append(image);
    const close = document.createElement("button");
    close.type = "button";
    close.textContent = "Close";
    close.addEventListener("click", () => dialog.close());
    dialog.replaceChildren(view, close);
    dialog.showModal();
  });
}

/* Contents are folded where they would fill the screen; on paper nothing is. */
if (window.matchMedia("(max-width: 40rem)").matches) document.querySelector("nav details").open = false;
window.addEventListener("beforeprint", () => {
  for (const each of document.querySelectorAll("details")) each.open = true;
});

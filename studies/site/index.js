// Sorting and filtering. The page contains all numbers and ranks; this script chooses what is shown.
// The address says which filters are set: #track=walk&scene=gc-v0&family=motion.
"use strict";

for (const track of document.querySelectorAll(".track")) {
  const filters = track.querySelector(".filters");
  if (!filters) continue;
  filters.hidden = false;
  const tables = [...track.querySelectorAll("table")];
  for (const table of tables) {
    for (const head of table.querySelectorAll("th[data-sort]")) makeSortable(table, head);
  }
  filters.addEventListener("change", () => {
    show(filters, tables);
    address(track, filters);
  });
  const follow = () => {
    const asked = new URLSearchParams(location.hash.slice(1));
    if (asked.get("track") !== track.id) return;
    for (const select of filters.querySelectorAll("select")) {
      const value = asked.get(select.name) ?? "";
      if ([...select.options].some((option) => option.value === value)) select.value = value;
    }
    show(filters, tables);
    track.scrollIntoView();
  };
  addEventListener("hashchange", follow);
  show(filters, tables);
  follow();
}

function address(track, filters) {
  const set = [...filters.querySelectorAll("select")].filter((select) => select.value !== "");
  const query = new URLSearchParams({ track: track.id });
  for (const select of set) query.set(select.name, select.value);
  history.replaceState(null, "", `#${set.length ? query : track.id}`);
}

function makeSortable(table, head) {
  const label = head.firstElementChild;
  const button = document.createElement("button");
  button.type = "button";
  label.replaceWith(button);
  button.append(label);
  button.addEventListener("click", () => {
    const again = { ascending: "descending", descending: "ascending" }[head.getAttribute("aria-sort")];
    const first = head.dataset.sort === "up" ? "ascending" : "descending";
    sort(table, head, again ?? first);
  });
}

function sort(table, head, direction) {
  for (const other of table.querySelectorAll("th[aria-sort]")) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", direction);
  const column = [...head.parentElement.children].indexOf(head);
  const sign = direction === "ascending" ? 1 : -1;
  const body = table.tBodies[0];
  const rows = [...body.rows].map((row) => [valueOf(row.cells[column]), row]);
  // Rows without a value are last in both directions.
  rows.sort(([a], [b]) => (a === "") - (b === "") || sign * compare(a, b));
  body.append(...rows.map(([, row]) => row));
  rule(table, head.classList.contains("rank"));
}

function valueOf(cell) {
  const shown = cell.querySelector("[data-value]:not([hidden])");
  if (!shown) return cell.textContent;
  return shown.dataset.value === "" ? "" : Number(shown.dataset.value);
}

function compare(a, b) {
  return typeof a === "number" ? a - b : a.localeCompare(b);
}

// Sorted by rank, lines separate tie groups; in any other order, they separate all rows.
function rule(table, byRank) {
  let last = null;
  for (const row of table.tBodies[0].rows) {
    if (row.hidden) continue;
    const rank = byRank ? row.cells[0].querySelector(":not([hidden])").textContent : null;
    row.classList.toggle("edge", !byRank || (rank !== "" && last !== null && rank !== last));
    last = rank || last;
  }
}

function show(filters, tables) {
  const { scene, family, kind } = Object.fromEntries(
    [...filters.querySelectorAll("select")].map((select) => [select.name, select.value]),
  );
  let shown = 0, all = 0;
  for (const table of tables) {
    for (const part of table.querySelectorAll("[data-scene], [data-family]")) {
      part.hidden =
        (part.dataset.family ?? family) !== family || (part.dataset.scene ?? scene) !== scene;
    }
    for (const cell of table.querySelectorAll("[data-column]")) {
      cell.hidden = cell.dataset.column === scene;  // the first column shows it already
    }
    for (const row of table.tBodies[0].rows) {
      row.hidden =
        (scene !== "" && !row.dataset.scenes.split(" ").includes(scene)) ||
        (kind !== "" && ![kind, "reference"].includes(row.dataset.kind));
      if (row.dataset.kind === "reference") continue;
      all += 1;
      shown += row.hidden ? 0 : 1;
    }
    const listed = table.closest(".listed");
    if (listed) listed.hidden = [...table.tBodies[0].rows].every((row) => row.hidden);
    const first = table.querySelector("th.rank") ?? table.querySelector("th.score");
    sort(table, first, first.dataset.sort === "up" ? "ascending" : "descending");
  }
  filters.querySelector("output").textContent = `${shown} of ${all} ${all === 1 ? "entry" : "entries"}`;
}

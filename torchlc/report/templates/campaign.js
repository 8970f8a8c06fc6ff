"use strict";
// The table of a campaign: sorted and filtered here, a page of rows at a time, every cell set as text.
const read = id => JSON.parse(document.getElementById(id).textContent);
const names = read("columns");
const objects = read("rows").map(row => Object.fromEntries(names.map((name, i) => [name, row[i]])));
const text = object => [object.id, object.task, object.result, object.reason].join("\n").toLowerCase();
const PAGE = 200;
const state = { key: null, down: false, words: "", status: "", shown: PAGE };

const number = (value, digits) => (value === null ? "" : value.toFixed(digits));
const value = {
  result: object => object.result ?? object.reason,
  chi2: object => (object.chi2 === null || !object.dof ? null : object.chi2 / object.dof),
};
const cells = {
  chi2: object => number(value.chi2(object), 2),
  rms_mag: object => number(object.rms_mag, 3),
  global_p: object => (object.global_p === null ? "" : object.global_p.toPrecision(2)),
  seconds: object => number(object.seconds, 1),
};
const of = (object, key) => (value[key] ?? (o => o[key]))(object);

function compare(a, b) {
  const [x, y] = [of(a, state.key), of(b, state.key)];
  if (x === null || y === null) return (x === null) - (y === null);
  const order = typeof x === "number" ? x - y : String(x).localeCompare(String(y), undefined, { numeric: true });
  return state.down ? -order : order;
}

function chosen() {
  const found = objects.filter(o => (!state.status || o.status === state.status) && text(o).includes(state.words));
  return state.key === null ? found : found.sort(compare);
}

function cell(object, key) {
  const td = document.createElement("td");
  const words = key in cells ? cells[key](object) : of(object, key) ?? "";
  td.className = { id: "name", result: "words" }[key] ?? (key in cells ? "number" : "");
  if (key === "id") {
    const link = document.createElement(object.status === "done" ? "a" : "span");
    link.textContent = words;
    if (object.status === "done") link.href = `${object.directory}/report.html`;
    td.append(link);
  } else if (key === "result" && object.status === "failed") {
    const mark = document.createElement("span");
    mark.className = "no";
    mark.textContent = `failed: ${words}`;
    td.append(mark);
  } else td.textContent = words;
  return td;
}

const heads = [...document.querySelectorAll("th[data-key]")];
const body = document.querySelector("#table tbody");
const more = document.getElementById("more");

function draw() {
  const found = chosen();
  const page = found.slice(0, state.shown);
  body.replaceChildren(...page.map(object => {
    const tr = document.createElement("tr");
    tr.append(...heads.map(head => cell(object, head.dataset.key)));
    return tr;
  }));
  document.getElementById("count").textContent =
    `${found.length} of ${objects.length} objects` + (page.length < found.length ? `, the first ${page.length} shown` : "");
  more.hidden = page.length === found.length;
  for (const head of heads) {
    if (head.dataset.key === state.key) head.setAttribute("aria-sort", state.down ? "descending" : "ascending");
    else head.removeAttribute("aria-sort");
  }
}

for (const head of heads) {
  head.firstElementChild.addEventListener("click", () => {
    state.down = state.key === head.dataset.key && !state.down;
    state.key = head.dataset.key;
    draw();
  });
}
const statuses = [...document.querySelectorAll("[data-status]")];
for (const button of statuses) {
  button.addEventListener("click", () => {
    for (const other of statuses) other.setAttribute("aria-pressed", String(other === button));
    Object.assign(state, { status: button.dataset.status, shown: PAGE });
    draw();
  });
}
document.getElementById("filter").addEventListener("input", event => {
  Object.assign(state, { words: event.target.value.toLowerCase(), shown: PAGE });
  draw();
});
more.addEventListener("click", () => {
  state.shown += PAGE;
  draw();
});
draw();

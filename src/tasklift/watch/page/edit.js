"use strict";
/* The page holds the lines of the edits file; the server applies them, and this draws what comes of it. */
const document_ = JSON.parse(document.getElementById("data").textContent);
const by = (id) => document.getElementById(id), svg = by("plan");
const SVG = "http://www.w3.org/2000/svg";
let { building, lines } = document_, tool = "select", chosen = null, from = null, saved = true;
let view = fitted();

/** An element of the drawing; what is drawn is (x, -y), since y points down on a screen. */
function draw(name, attributes, parent = svg) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return parent.appendChild(element);
}

function fitted() {
  const points = building.nodes.map((n) => [n.x, n.y]).concat(document_.plan ? document_.plan.corners : []);
  const xs = points.map((p) => p[0]), ys = points.map((p) => -p[1]);
  const x = Math.min(...xs) - 1, y = Math.min(...ys) - 1;
  return { x, y, w: Math.max(...xs) + 1 - x, h: Math.max(...ys) + 1 - y };
}

function render() {
  svg.replaceChildren();
  svg.setAttribute("viewBox", `${view.x} ${view.y} ${view.w} ${view.h}`);
  const size = Math.max(view.w / svg.clientWidth, view.h / svg.clientHeight) || 0.05, r = Math.min(6 * size, 0.4);
  if (document_.plan) {
    const [low, right, up] = document_.plan.corners;
    const matrix = [right[0] - low[0], low[1] - right[1], low[0] - up[0], up[1] - low[1], up[0], -up[1]];
    draw("image", { href: document_.plan.href, width: 1, height: 1, preserveAspectRatio: "none", transform: `matrix(${matrix})` });
  }
  building.edges.forEach((edge, i) => {
    const points = edge.line.map(([x, y]) => `${x},${-y}`).join(" ");
    const mark = chosen && chosen.edge === i ? " chosen" : "";
    draw("polyline", { points, class: `edge${mark}`, "stroke-width": r * 0.7, "data-edge": i });
  });
  building.nodes.forEach((node, i) => {
    const mark = (chosen && chosen.node === i) || from === i ? " chosen" : "";
    draw("circle", { cx: node.x, cy: -node.y, r: node.class === "room" ? 1.4 * r : r, class: `node ${node.class}${mark}`, "stroke-width": r / 3, "data-node": i });
    if (i === building.start) draw("circle", { cx: node.x, cy: -node.y, r: 2 * r, fill: "none", stroke: "var(--safe)", "stroke-width": r / 2 });
    draw("text", { x: node.x + r, y: -node.y - r, "font-size": 1.9 * r }).textContent = i;
  });
  by("lines").replaceChildren(...lines.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
  by("undo").disabled = !lines.length;
  by("one").hidden = !chosen;
  if (chosen) {
    const node = building.nodes[chosen.node];
    by("what").textContent = node ? `node ${chosen.node}: ${node.class}${node.class === "room" ? `, ${node.area} m²` : ""}` : `corridor ${building.edges[chosen.edge].a}–${building.edges[chosen.edge].b}`;
    by("kind").hidden = by("start").hidden = !node;
    if (node) by("class").value = node.class;
  }
}

function say(text, bad = false) {
  by("said").textContent = text;
  by("said").classList.toggle("bad", bad);
}

async function ask(path, body) {
  try {
    const answer = await fetch(path, { method: "POST", body: JSON.stringify(body) });
    if (!answer.ok) return { error: `the server answers ${answer.status}` };
    return await answer.json();
  } catch {
    return { error: "the server has ended; start 'tasklift map edit --browser' again" };
  }
}

/** Try the lines; keep them if they apply. */
let waiting = Promise.resolve();
function become(next) {
  waiting = waiting.then(async () => {
    const proposed = next(lines), answer = await ask("/apply", proposed);
    if (answer.error) say(answer.error, true);
    else {
      ({ building } = answer);
      lines = proposed;
      chosen = from = null;
      saved = false;
      say(`${lines.length} ${lines.length === 1 ? "edit" : "edits"}, not saved yet`);
    }
    render();
  });
  return waiting;
}
const add = (line) => become((before) => [...before, line]);
const at = ({ x, y }) => `${x.toFixed(3)} ${y.toFixed(3)}`;

function place(event) {
  const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  return { x: point.x, y: -point.y };
}

let drag = null;
svg.addEventListener("pointerdown", (event) => {
  const { node, edge } = event.target.dataset;
  drag = { node: node === undefined ? null : +node, edge: edge === undefined ? null : +edge, begin: place(event), screen: [event.clientX, event.clientY], moved: false };
  svg.setPointerCapture(event.pointerId);
});
svg.addEventListener("pointermove", (event) => {
  if (!drag) return;
  if (Math.hypot(event.clientX - drag.screen[0], event.clientY - drag.screen[1]) > 4) drag.moved = true;
  if (!drag.moved) return;
  const here = place(event);
  if (drag.node !== null && tool === "select") {
    const circle = svg.querySelector(`[data-node="${drag.node}"]`);
    circle.setAttribute("cx", here.x);
    circle.setAttribute("cy", -here.y);
  } else {
    view.x += drag.begin.x - here.x;
    view.y += here.y - drag.begin.y;
    svg.setAttribute("viewBox", `${view.x} ${view.y} ${view.w} ${view.h}`);
  }
});
svg.addEventListener("pointerup", (event) => {
  const was = drag, here = place(event);
  drag = null;
  if (!was) return;
  if (was.moved) {
    if (was.node !== null && tool === "select") add(`move node at ${at(building.nodes[was.node])} to ${at(here)}`);
    else render();
  } else if (tool === "room") add(`add room at ${at(here)} area ${+by("area").value || 12}`);
  else if (tool === "door" || tool === "node") add(`add ${tool} at ${at(here)}`);
  else if (tool === "edge" && was.node !== null) {
    if (from === null || from === was.node) { from = from === null ? was.node : null; render(); }
    else add(`add edge from ${at(building.nodes[from])} to ${at(building.nodes[was.node])}`);
  } else {
    chosen = was.node !== null ? { node: was.node } : was.edge !== null ? { edge: was.edge } : null;
    render();
  }
});
svg.addEventListener("wheel", (event) => {
  event.preventDefault();
  const here = place(event), by_ = event.deltaY > 0 ? 1.2 : 1 / 1.2;
  view = { x: here.x + (view.x - here.x) * by_, y: -here.y + (view.y + here.y) * by_, w: view.w * by_, h: view.h * by_ };
  render();
}, { passive: false });

for (const button of document.querySelectorAll("[data-tool]")) {
  button.addEventListener("click", () => {
    tool = button.dataset.tool;
    from = chosen = null;
    for (const other of document.querySelectorAll("[data-tool]")) other.setAttribute("aria-pressed", other === button);
    render();
  });
}
function remove() {
  if (!chosen) return;
  if (chosen.node !== undefined) add(`drop node at ${at(building.nodes[chosen.node])}`);
  else {
    const { a, b } = building.edges[chosen.edge];
    add(`drop edge from ${at(building.nodes[a])} to ${at(building.nodes[b])}`);
  }
}
const undo = () => lines.length && become((before) => before.slice(0, -1));
async function save() {
  await waiting;
  const answer = await ask("/save", lines);
  saved = !answer.error;
  say(answer.error || answer.said, Boolean(answer.error));
}
by("delete").addEventListener("click", remove);
by("undo").addEventListener("click", undo);
by("save").addEventListener("click", save);
by("start").addEventListener("click", () => add(`start at ${at(building.nodes[chosen.node])}`));
by("class").addEventListener("change", () => {
  const to = by("class").value, area = to === "room" ? ` area ${+by("area").value || 12}` : "";
  add(`set class at ${at(building.nodes[chosen.node])} to ${to}${area}`);
});
document.addEventListener("keydown", (event) => {
  if (event.target.matches("input, select")) return;
  if (event.key === "Delete" || event.key === "Backspace") remove();
  else if (event.key === "Escape") { chosen = from = null; render(); }
  else if ((event.ctrlKey || event.metaKey) && event.key === "z") { event.preventDefault(); undo(); }
  else if ((event.ctrlKey || event.metaKey) && event.key === "s") { event.preventDefault(); save(); }
});
addEventListener("beforeunload", (event) => { if (!saved) event.preventDefault(); });
addEventListener("resize", render);
render();

"use strict";
// Text from outside only ever goes through textContent and setAttribute.
const SVG = "http://www.w3.org/2000/svg";

function make(name, attributes, text, parent) {
  const element = document.createElementNS(SVG, name);
  for (const key in attributes) element.setAttribute(key, attributes[key]);
  if (text !== undefined) element.textContent = text;
  parent.appendChild(element);
  return element;
}

function curves(figure, data) {
  const svg = figure.querySelector("svg"), guide = svg.querySelector(".guide");
  const groups = [...svg.querySelectorAll(".series")], tip = document.createElement("div");
  tip.className = "tip"; tip.hidden = true; figure.appendChild(tip);
  figure.querySelectorAll(".legend span").forEach((label, i) => {
    const button = document.createElement("button");
    button.type = "button"; button.className = label.className;
    button.append(...label.childNodes); button.setAttribute("aria-pressed", "true");
    button.addEventListener("click", () => {
      const shown = groups[i].hasAttribute("hidden");
      groups[i].toggleAttribute("hidden", !shown);
      button.setAttribute("aria-pressed", String(shown));
    });
    label.replaceWith(button);
  });
  const [left, right] = data.from, first = data.x[0], last = data.x[data.x.length - 1];
  const place = x => left + (last > first ? (x - first) / (last - first) : 0) * (right - left);
  svg.addEventListener("pointermove", event => {
    const box = svg.getBoundingClientRect(), wide = svg.viewBox.baseVal.width;
    const at = (event.clientX - box.left) / box.width * wide;
    let k = 0;
    data.x.forEach((x, i) => { if (Math.abs(place(x) - at) < Math.abs(place(data.x[k]) - at)) k = i; });
    guide.setAttribute("x1", place(data.x[k])); guide.setAttribute("x2", place(data.x[k]));
    guide.setAttribute("visibility", "visible");
    tip.replaceChildren(`${data.label} ${data.x[k]}`);
    data.series.forEach((one, i) => {
      if (groups[i].hasAttribute("hidden") || k >= one.y.length) return;
      const line = document.createElement("div"), name = document.createElement("b");
      name.className = groups[i].getAttribute("class").replace("series", ""); name.textContent = one.name;
      line.append(name, ` ${one.y[k]}` + (one.low ? `  [${one.low[k]}, ${one.high[k]}]` : ""));
      tip.append(line);
    });
    tip.hidden = false;
    const side = event.clientX - figure.getBoundingClientRect().left;
    tip.style.top = "1rem";
    tip.style.left = Math.max(0, side > box.width / 2 ? side - tip.offsetWidth - 18 : side + 18) + "px";
  });
  svg.addEventListener("pointerleave", () => { tip.hidden = true; guide.setAttribute("visibility", "hidden"); });
}

// The same drawing as bars_svg in charts.py; keep the two alike.
function drawBars(svg, s) {
  svg.replaceChildren();
  const n = s.rows.length, m = s.columns.length, low = s.ticks[0], high = s.ticks[s.ticks.length - 1];
  const depth = Math.max(n, 0.5 * m), unit = 370 / Math.hypot(m, depth);
  const cosT = Math.cos(s.turn), sinT = Math.sin(s.turn), cosE = Math.cos(s.tilt), sinE = Math.sin(s.tilt);
  const project = ([x, y, z]) => [240 + (x * cosT - y * sinT) * unit,
    222 + (x * sinT + y * cosT) * unit * sinE - (z - low) / (high - low) * 150 * cosE];
  const points = corners => corners.map(c => project(c).map(v => v.toFixed(1)).join(",")).join(" ");
  const w = m / 2, d = depth / 2, sideX = sinT > 0 ? -w : w, sideY = cosT > 0 ? -d : d;
  make("polygon", {class: "floor", points: points([[-w, -d, low], [w, -d, low], [w, d, low], [-w, d, low]])}, undefined, svg);
  s.ticks.forEach((mark, k) => {
    const wall = [[-sideX, sideY, mark], [sideX, sideY, mark], [sideX, -sideY, mark]];
    make("polyline", {class: "grid", points: points(wall)}, undefined, svg);
    const a = project(wall[0]), b = project(wall[2]), at = a[0] < b[0] ? a : b;
    make("text", {class: "tick end", x: at[0] - 6, y: at[1] + 4}, s.tickTexts[k], svg);
  });
  const places = [];
  for (let i = 0; i < n; i++) for (let j = 0; j < m; j++) places.push([j - w + 0.5, (i + 0.5) * depth / n - d, i, j]);
  places.sort((p, q) => p[0] * sinT + p[1] * cosT - q[0] * sinT - q[1] * cosT);
  for (const [x, y, i, j] of places) {
    const zero = Math.max(0, low), r = 0.32, base = Math.min(zero, s.z[i][j]), top = Math.max(zero, s.z[i][j]);
    const X = x + (sinT > 0 ? r : -r), Y = y + (cosT > 0 ? r : -r);
    const bar = make("g", {class: `bar c${s.colours[j]}`}, undefined, svg);
    make("title", {}, `${s.rows[i]}, ${s.columns[j]}: ${s.texts[i][j]}`, bar);
    make("polygon", {class: "side", points: points([[X, y - r, base], [X, y + r, base], [X, y + r, top], [X, y - r, top]])}, undefined, bar);
    make("polygon", {class: "front", points: points([[x - r, Y, base], [x + r, Y, base], [x + r, Y, top], [x - r, Y, top]])}, undefined, bar);
    make("polygon", {class: "top", points: points([[x - r, y - r, top], [x + r, y - r, top], [x + r, y + r, top], [x - r, y + r, top]])}, undefined, bar);
  }
  s.columns.forEach((name, j) => {
    const at = project([j - w + 0.5, -sideY * 1.18, low]);
    make("text", {class: "tick mid", x: at[0], y: at[1] + 10}, name, svg);
  });
  const anchor = project([-sideX, 0, low])[0] > 240 ? "start" : "end";
  s.rows.forEach((name, i) => {
    const at = project([-sideX * 1.06, (i + 0.5) * depth / n - d, low]);
    make("text", {class: `tick ${anchor}`, x: at[0], y: at[1] + 10}, name, svg);
  });
  make("text", {class: "label start", x: 8, y: 16}, s.label, svg);
}

function bars(figure, scene) {
  const svg = figure.querySelector("svg");
  svg.classList.add("turns"); svg.setAttribute("tabindex", "0");
  const turn = (dx, dy) => {
    scene.turn += dx; scene.tilt = Math.min(1.1, Math.max(0.1, scene.tilt + dy));
    drawBars(svg, scene);
  };
  let from = null;
  svg.addEventListener("pointerdown", event => { from = [event.clientX, event.clientY]; svg.setPointerCapture(event.pointerId); });
  svg.addEventListener("pointermove", event => {
    if (!from) return;
    turn((from[0] - event.clientX) * 0.01, (event.clientY - from[1]) * 0.008);
    from = [event.clientX, event.clientY];
  });
  for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => { from = null; });
  svg.addEventListener("keydown", event => {
    const by = {ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08]}[event.key];
    if (by) { turn(...by); event.preventDefault(); }
  });
  figure.querySelector(".hint").hidden = false;
}

for (const figure of document.querySelectorAll("figure[data-chart]")) {
  const data = JSON.parse(figure.querySelector("script").textContent);
  (figure.dataset.chart === "curves" ? curves : bars)(figure, data);
}

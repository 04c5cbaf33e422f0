"use strict";
// Text from outside only ever goes through textContent and setAttribute.
function button(label, pressed) {
  const made = document.createElement("button");
  made.type = "button"; made.className = label.className; made.style.cssText = label.style.cssText;
  made.append(...label.childNodes); made.setAttribute("aria-pressed", String(pressed));
  return made;
}

function curves(figure, data) {
  const svg = figure.querySelector("svg"), guide = svg.querySelector(".guide");
  const groups = [...svg.querySelectorAll(".series")], tip = document.createElement("div");
  tip.className = "tip"; tip.hidden = true; figure.appendChild(tip);
  figure.querySelectorAll(".ends span").forEach((label, i) => {
    const made = button(label, true);
    made.addEventListener("click", () => {
      const shown = groups[i].hasAttribute("hidden");
      groups[i].toggleAttribute("hidden", !shown);
      made.setAttribute("aria-pressed", String(shown));
    });
    label.replaceWith(made);
  });
  if (data.series.some(one => one.each)) {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox"; box.checked = true; label.className = "switch";
    box.addEventListener("change", () => {
      document.body.classList.toggle("unsmoothed", !box.checked);
      document.querySelectorAll(".switch input").forEach(other => { other.checked = box.checked; });
    });
    label.append(box, " running mean of 10"); figure.appendChild(label);
  }
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
    const raw = document.body.classList.contains("unsmoothed");
    data.series.forEach((one, i) => {
      if (groups[i].hasAttribute("hidden") || k >= one.y.length) return;
      const line = document.createElement("div"), name = document.createElement("b");
      name.className = groups[i].getAttribute("class").replace("series", ""); name.textContent = one.name;
      if (raw && one.each) line.append(name, ` ${one.each[k]}`);
      else line.append(name, ` ${one.y[k]}` + (one.low ? `  [${one.low[k]}, ${one.high[k]}]` : ""));
      tip.append(line);
    });
    tip.hidden = false;
    const side = event.clientX - figure.getBoundingClientRect().left;
    tip.style.top = "1rem";
    tip.style.left = Math.max(0, side > box.width / 2 ? side - tip.offsetWidth - 18 : side + 18) + "px";
  });
  svg.addEventListener("pointerleave", () => { tip.hidden = true; guide.setAttribute("visibility", "hidden"); });
}

for (const figure of document.querySelectorAll("figure[data-chart]"))
  curves(figure, JSON.parse(figure.querySelector("script").textContent));

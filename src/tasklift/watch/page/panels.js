// The page around the drawings: panels with their numbers, the timeline, the events, the robot that is looked at.

/** An element with text and children. Text is text: nothing in a replay is ever markup. */
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

const byId = (id) => document.getElementById(id);
const percent = (share) => (share > 0 && share < 0.1 ? `${(100 * share).toFixed(1)} %` : `${Math.round(100 * share)} %`);
const SIGNS = { alert: "▲", attack: "◆", loss: "✕", cleared: "●", searched: "■", split: "<", merge: ">" };
const NAMES = {
  alert: ["alert", "alerts"], attack: ["attack", "attacks"], loss: ["loss", "losses"], cleared: ["cleared", "cleared"],
  searched: ["searched", "searched"], split: ["split", "splits"], merge: ["merge", "merges"],
};

/** A trace's name, floor plan and numbers of the moment. */
class Panel {
  constructor(trace, view, plan, kinds) {
    this.trace = trace;
    this.canvas = make("canvas", { role: "img", "aria-label": `Floor plan: ${trace.label}` });
    this.tip = make("div", { class: "tip", hidden: "" });
    this.chip = make("span", { class: "chip" });
    this.plan = make("div", { class: "plan" }, this.canvas, this.tip);
    this.values = {};
    const stats = make("dl", { class: "stats" });
    const stat = (name, label) => {
      this.values[name] = make("dd", { "data-stat": name });
      stats.append(make("div", {}, make("dt", {}, label), this.values[name]));
    };
    stat("explored", "explored");
    stat("robots", "robots");
    stat("teams", "teams");
    stat("losses", trace.reading.drill ? "would be lost" : "lost");
    stat("messages", "messages");
    stat("searched", "rooms");
    stat("hostiles", "hostiles left");
    this.counts = kinds.map((kind, i) => {
      const count = make("span", { "data-kind": i });
      this.values.robots.append(kindSign(kinds, i), count);
      return count;
    });
    const trial = `trial ${trace.trial}`, seed = `seed ${trace.seed}`;
    this.head = make("header", {}, make("span", { class: "label" }, trace.label), make("span", { class: "trial" }, trace.label.endsWith(trial) ? seed : `${trial} · ${seed}`), this.chip);
    const about = `${this.ends()}${trace.meaning ? ` ${trace.meaning[0].toUpperCase()}${trace.meaning.slice(1)}.` : ""}`;
    this.head.append(make("p", { class: "about", title: about }, about));
    this.element = make("article", { class: "panel" }, this.head, this.plan, stats);
    this.scene = new Scene(this.canvas, trace, view, plan);
  }

  /** How the episode ends, for those who have not watched it. */
  ends() {
    const { trace } = this, n = trace.numbers(trace.F - 1), lost = trace.reading.drill ? "would be lost" : "lost";
    const how = { done: `Solved in ${trace.F - 1} steps`, "all lost": "All robots are lost", "out of time": "Not solved in time" };
    return `${how[n.outcome] || "Not over yet"}, ${n.losses} ${lost}.`;
  }

  show(time) {
    const { trace } = this, t = Math.min(Math.floor(time), trace.F - 1);
    if (t !== this.shown) this.tell(t);
    this.shown = t;
    this.scene.draw(time);
  }

  tell(t) {
    const { trace, values } = this, n = trace.numbers(t);
    values.explored.textContent = percent(n.explored);
    this.counts.forEach((count, i) => { count.textContent = n.byKind[i]; });
    values.teams.textContent = n.teams;
    values.losses.textContent = n.losses;
    values.losses.className = n.losses > 0 ? "bad" : "";
    values.messages.textContent = n.messages;
    values.searched.textContent = `${n.searched} of ${trace.building.rooms.length}`;
    values.hostiles.textContent = n.hostiles;
    this.chip.textContent = { "": `step ${t}`, done: `done in ${t} steps`, "all lost": `all lost at step ${t}`, "out of time": "out of time" }[n.outcome];
    this.chip.className = `chip ${{ done: "done", "all lost": "lost", "out of time": "late" }[n.outcome] || ""}`;
  }
}

/** The shape of a kind of robot, as in the plan, for use in text. */
function kindSign(kinds, i) {
  const canvas = make("canvas", { class: "glyph", width: 32, height: 32, title: kinds[i].name });
  canvas.repaint = () => {
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, 32, 32);
    robotShape(pen, kinds, i, 16, 17, 13);
  };
  canvas.repaint();
  return canvas;
}

/** All traces over one axis of time: explored share as an area, robots left as a line, events as signs. */
class Timeline {
  constructor(player) {
    this.player = player;
    this.rows = player.panels.map(({ trace }) => {
      const canvas = make("canvas");
      byId("rows").append(make("div", { class: "row", title: trace.label }, make("span", {}, trace.label), canvas));
      return { trace, canvas };
    });
    const area = byId("timeline");
    area.addEventListener("pointerdown", (event) => {
      area.setPointerCapture(event.pointerId);
      this.seek(event, true);
      area.onpointermove = (moved) => this.seek(moved, false);
    });
    for (const end of ["pointerup", "pointercancel"]) area.addEventListener(end, () => { area.onpointermove = null; });
  }

  x(t, width) { return 6 + (t / Math.max(1, this.player.last)) * (width - 12); }

  /** Go to a point in time; a press near an event's sign goes to the event. */
  seek(event, snap) {
    const row = this.rows.find(({ canvas }) => event.clientY <= canvas.getBoundingClientRect().bottom) || this.rows[this.rows.length - 1];
    const box = row.canvas.getBoundingClientRect();
    const time = Math.max(0, Math.min(this.player.last, ((event.clientX - box.left - 6) / (box.width - 12)) * this.player.last));
    if (snap) {
      this.player.look(this.rows.indexOf(row));
      const near = row.trace.events
        .filter((e) => e.type !== "split" && e.type !== "merge")
        .map((e) => ({ e, far: Math.abs(this.x(e.t, box.width) - (event.clientX - box.left)) }))
        .sort((p, q) => p.far - q.far)[0];
      if (near && near.far < 5) return this.player.visit(near.e);
    }
    this.player.go(Math.round(time));
  }

  draw() {
    const [{ canvas: first }] = this.rows;
    this.left = first.getBoundingClientRect().left - byId("timeline").getBoundingClientRect().left;
    this.width = first.clientWidth;
    for (const { trace, canvas } of this.rows) {
      const width = canvas.clientWidth, height = canvas.clientHeight, ratio = Math.min(3, window.devicePixelRatio || 1);
      canvas.width = width * ratio;
      canvas.height = height * ratio;
      const pen = canvas.getContext("2d"), signs = Math.min(13, height * 0.42), top = 3, floor = height - signs;
      pen.scale(ratio, ratio);
      const level = (share) => floor - share * (floor - top);
      const trail = (of) => {
        for (let t = 0; t < trace.F; t++) pen.lineTo(this.x(t, width), level(of(t)));
      };
      pen.beginPath();
      pen.moveTo(this.x(0, width), floor);
      trail((t) => trace.explored[t] / trace.building.e);
      pen.lineTo(this.x(trace.F - 1, width), floor);
      pen.fillStyle = palette.accent;
      pen.globalAlpha = 0.22;
      pen.fill();
      pen.globalAlpha = 1;
      pen.beginPath();
      trail((t) => trace.living[t] / Math.max(1, trace.R));
      pen.strokeStyle = palette.kind0;
      pen.lineWidth = 1.5;
      pen.stroke();
      pen.textAlign = "center";
      pen.textBaseline = "middle";
      pen.font = `bold ${Math.round(signs - 2)}px system-ui, sans-serif`;
      for (const order of ["split", "merge", "searched", "cleared", "alert", "attack", "loss"]) {
        pen.fillStyle = { alert: palette.alert, attack: palette.danger, loss: palette.danger, cleared: palette.safe, searched: palette.safe }[order] || palette.mark;
        for (const e of trace.events) {
          if (e.type !== order) continue;
          const x = this.x(e.t, width);
          if (order === "split" || order === "merge") pen.fillRect(x - 0.5, height - 3, 1, 3);
          else pen.fillText(SIGNS[order], x, height - signs / 2);
        }
      }
      const end = this.x(trace.F - 1, width);
      pen.fillStyle = trace.success ? palette.safe : palette.danger;
      pen.fillRect(end, top, 2, height - top);
    }
  }

  show(time) { byId("playhead").style.left = `${this.left + this.x(time, this.width)}px`; }
}

/** How many of the events, in order of time, have happened by then. */
function upTo(events, time) {
  let [low, high] = [0, events.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (events[middle].t <= time) low = middle + 1; else high = middle;
  }
  return low;
}

/** The events of the panel that is looked at. */
class Log {
  constructor(player) {
    this.player = player;
    this.wanted = new Set(Object.keys(NAMES).filter((type) => type !== "split" && type !== "merge"));
    this.buttons = {};
    for (const type of Object.keys(NAMES)) {
      const button = make("button", { "aria-pressed": String(this.wanted.has(type)), "data-type": type });
      button.addEventListener("click", () => {
        this.wanted.has(type) ? this.wanted.delete(type) : this.wanted.add(type);
        button.setAttribute("aria-pressed", String(this.wanted.has(type)));
        this.fill();
        this.show(player.time);
      });
      byId("filters").append(button);
      this.buttons[type] = button;
    }
  }

  fill() {
    const { trace } = this.player.active;
    byId("log-of").textContent = this.player.panels.length > 1 ? trace.label : "";
    for (const [type, button] of Object.entries(this.buttons)) {
      const count = trace.events.filter((e) => e.type === type).length;
      button.replaceChildren(make("span", { class: `sign ${type}` }, SIGNS[type]), `${count} ${NAMES[type][count === 1 ? 0 : 1]}`);
      button.hidden = count === 0;
    }
    this.events = trace.events.filter((e) => this.wanted.has(e.type));
    this.first = this.past = -1;
    this.show(this.player.time);
  }

  /** Mark what has happened; long lists are shown a stretch at a time, around the present. */
  show(time) {
    const list = byId("events"), past = upTo(this.events, time);
    const first = Math.max(0, Math.floor((past - 100) / 100) * 100);
    if (first !== this.first) {
      list.replaceChildren(...this.events.slice(first, first + 400).map((e) => {
        const button = make("button", { "data-step": e.t }, make("span", {}, String(e.t)), make("span", { class: `sign ${e.type}` }, SIGNS[e.type]), make("span", {}, e.text));
        button.addEventListener("click", () => this.player.visit(e));
        return make("li", {}, button);
      }));
      this.first = first;
      this.past = -1;
    }
    if (past === this.past) return;
    const [low, high] = this.past < 0 ? [0, list.children.length] : [Math.min(past, this.past) - first - 1, Math.max(past, this.past) - first + 1];
    for (let i = Math.max(0, low); i < Math.min(high, list.children.length); i++) {
      list.children[i].firstChild.className = `${first + i >= past ? "later" : ""}${first + i === past - 1 ? "now" : ""}`;
    }
    this.past = past;
    const now = list.querySelector(".now");
    if (now && !list.matches(":hover")) list.scrollTop = now.offsetTop - list.clientHeight / 2;
    else if (!now) list.scrollTop = 0;
  }
}

/** One robot: where it is, what it senses, what it drew, and from which chances. */
class Inspector {
  constructor(player) {
    this.player = player;
    this.element = byId("inspector");
    this.picker = make("select", { "aria-label": "Robot" });
    const { kinds } = player.replay;
    this.picker.append(make("option", { value: -1 }, "choose …"));
    player.active.trace.kindOf.forEach((kind, r) => this.picker.append(make("option", { value: r }, `${r} · ${kinds[kind].name}`)));
    this.picker.addEventListener("change", () => player.select(Number(this.picker.value)));
    this.title = make("h2");
    this.body = make("div");
    this.element.append(this.title, this.body);
  }

  show(time) {
    const { player } = this, { trace } = player.active, r = player.selected, t = Math.min(Math.floor(time), trace.F - 1);
    const stamp = `${r} ${t} ${player.active.trace.label} ${player.panels.indexOf(player.active)} ${palette.paper}`;
    if (stamp === this.stamp) return;
    this.stamp = stamp;
    this.picker.value = r;
    if (r < 0) {
      this.title.replaceChildren("Why does it move?", this.picker);
      this.body.replaceChildren(make("p", { class: "hint" }, "Click a robot: its inputs, the output it drew, and the chances it drew from."));
      return;
    }
    this.title.replaceChildren(kindSign(trace.kinds, trace.kindOf[r]), "Robot", make("small", {}, player.panels.length > 1 ? trace.label : ""), this.picker);
    const parts = [make("p", { class: "state" }, this.state(trace, r, t))];
    const decision = trace.decision(r, t);
    const living = trace.alive(r, t);
    if (t > 0 && living) {
      const before = t > 1 ? digits(trace.task.inputs, trace.at("input", r, t - 1)) : [];
      parts.push(make("h3", {}, "What it senses"), this.facts(trace.task.inputs, digits(trace.task.inputs, trace.at("input", r, t)), before, "input"));
    }
    if (decision) parts.push(...this.chosen(trace, r, t, decision));
    else parts.push(make("p", { class: "hint" }, "It has not decided yet."));
    this.body.replaceChildren(...parts);
  }

  state(trace, r, t) {
    const { building } = trace;
    if (!trace.alive(r, t)) return `Lost at ${building.label(trace.at("place", r, trace.died[r]))} in step ${trace.died[r]}.`;
    const place = trace.at("place", r, t), members = trace.teams[t][trace.team[t * trace.R + r]];
    const team = members.length === 1 ? "alone" : `in a team of ${members.length}, ${trace.armed(members)} armed`;
    let where = `At ${building.label(place)}`;
    if (place >= building.n) {
      const [edge, from, to] = building.way(place);
      const metres = (building.length[edge] * Math.min(1, trace.at("progress", r, t) / building.cost[edge])).toFixed(1);
      where = `${metres} m of ${building.length[edge].toFixed(1)} m from ${building.label(from)} to ${building.label(to)}`;
    }
    const room = building.roomIndex.get(place);
    const searching = room !== undefined && trace.unsearched[room * trace.F + t] > 0;
    const doing = t === 0 ? "" : trace.at("held", r, t) ? ", repelled" : !trace.moves(r, t) ? ", stopped" : searching ? ", searching" : ", moving";
    return `${where}${doing}; ${team}.`;
  }

  facts(variables, values, before, what) {
    const list = make("dl", { class: variables.length === 3 ? "facts three" : "facts" });
    const name = (variable, value) => (variable.labels[value] === undefined ? variable.name : `${variable.name} ${variable.values[value]}`);
    variables.forEach((variable, i) => {
      const item = make("div", { title: name(variable, values[i]), [`data-${what}`]: variable.name }, make("dt", {}, variable.meaning || name(variable, values[i])), make("dd", {}, told(variable, values[i])));
      if (before.length && before[i] !== values[i]) item.className = "new";
      list.append(item);
    });
    return list;
  }

  chosen(trace, r, t, decision) {
    const { task } = trace, output = task.columns[decision.output], taken = digits(task.outputs, output);
    const ago = t - decision.frame;
    const when = ago === 0 ? "in this step" : ago === 1 ? "a step ago" : `${ago} steps ago`;
    const who = decision.drawer === r ? "" : `, by robot ${decision.drawer} for the team`;
    const parts = [make("h3", {}, `What it drew ${when}${who}`), this.facts(task.outputs, taken, [], "output")];
    const first = task.outputs[0], shares = first.values.map(() => 0);
    decision.probabilities.forEach((p, a) => { shares[digits(task.outputs, task.columns[a])[0]] += p; });
    parts.push(make("h3", {}, "The chances it drew from"));
    if (shares.length === 2) {
      const bar = make("div", { class: "split", "data-chances": first.name });
      shares.forEach((share, i) => {
        const part = make("span", { "data-value": first.values[i], class: taken[0] === i ? "taken" : "" }, share > 0.22 ? `${first.labels[i] ?? first.values[i]} ${percent(share)}` : "");
        part.style.width = `${100 * share}%`;
        bar.append(part);
      });
      parts.push(bar);
    }
    parts.push(this.table(task, decision));
    const weight = decision.weights[decision.output].toFixed(2);
    let why = `Drawn with ${percent(decision.probabilities[decision.output])}, weight ${weight}.`;
    if (decision.signal) {
      const reasons = decision.reasons.map((s) => s.name).join("; ") || "not possible in this state";
      why += ` Its signal: ${decision.signal > 0 ? "+" : "−"}${Math.abs(decision.signal).toFixed(2)} (${reasons}).`;
    }
    parts.push(make("p", { class: "why" }, why));
    return parts;
  }

  /** Bars for all outputs: the last variable along the rows, the others down. */
  table(task, decision) {
    const last = task.outputs.length - 1, rows = new Map(), most = Math.max(...decision.probabilities, 1e-12);
    decision.probabilities.forEach((p, a) => {
      const values = digits(task.outputs, task.columns[a]);
      const name = values.slice(0, last).map((v, i) => task.outputs[i].labels[v] ?? `${task.outputs[i].name} ${task.outputs[i].values[v]}`).join(", ");
      if (!rows.has(name)) rows.set(name, []);
      rows.get(name).push({ p, a, value: task.outputs[last].values[values[last]] });
    });
    const body = make("tbody");
    for (const [name, cells] of rows) {
      const row = make("tr", {}, make("th", { scope: "row" }, name));
      for (const { p, a, value } of cells) {
        const bar = make("i");
        bar.style.height = `${Math.max(3, 100 * p / most)}%`;
        const cell = make("td", { title: `${name}, ${task.outputs[last].name} ${value}: ${(100 * p).toFixed(2)} %`, "data-chance": p, "data-output": a, class: a === decision.output ? "drawn" : "" }, bar);
        row.append(cell);
      }
      body.append(row);
    }
    const foot = make("tr", {}, make("th", { scope: "row" }, task.outputs[last].name));
    for (const { value } of [...rows.values()][0]) foot.append(make("td", {}, value));
    return make("table", { class: "chances" }, body, make("tfoot", {}, foot));
  }
}

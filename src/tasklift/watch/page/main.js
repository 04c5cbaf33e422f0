// One clock for all panels, the controls and the keyboard.

const SPEEDS = [1, 2, 4, 8, 16, 32, 64]; // steps per second
const NARROW = window.matchMedia("(max-width: 820px)");

class Player {
  constructor(replay) {
    this.replay = replay;
    this.view = new View(replay.building);
    const plan = new Plan(replay.building);
    this.panels = replay.traces.map((trace) => new Panel(trace, this.view, plan, replay.kinds));
    this.last = Math.max(...replay.traces.map((trace) => trace.F - 1));
    this.time = 0;
    this.speed = 8;
    this.playing = false;
    this.selected = -1;
    this.active = this.panels[0];
    this.head();
    document.body.classList.add(this.panels.length > 1 ? "several" : "single");
    byId("stage").append(...this.panels.map((panel) => panel.element));
    this.panels.forEach((panel, i) => this.listen(panel, i));
    this.timeline = new Timeline(this);
    this.log = new Log(this);
    this.inspector = new Inspector(this);
    this.controls();
  }

  head() {
    const { building, kinds, title, traces } = this.replay;
    document.title = title;
    byId("title").textContent = title;
    byId("legend").open = firstVisit() && window.innerHeight >= 820;
    const team = kinds.map((k) => `${k.number} ${k.name}`).join(" and ");
    const [{ hostiles }] = traces;
    const name = title.includes(building.name) ? "" : `${building.name}: `;
    byId("about").textContent = `${name}${building.n} nodes, ${building.e} corridors; ${team} robots; ${hostiles.length === 1 ? "one hostile" : `${hostiles.length} hostiles`}`;
  }

  controls() {
    const scrub = byId("scrub"), speed = byId("speed");
    scrub.max = this.last;
    scrub.addEventListener("input", () => this.go(Number(scrub.value)));
    speed.append(...SPEEDS.map((s) => make("option", { value: s }, `${s} / s`)));
    speed.addEventListener("change", () => { this.speed = Number(speed.value); });
    speed.value = this.speed;
    const on = (id, act) => byId(id).addEventListener("click", act);
    on("to-start", () => this.go(0));
    on("back", () => this.step(-1));
    on("play", () => this.toggle());
    on("forward", () => this.step(1));
    on("to-end", () => this.go(this.last));
    on("fit", () => this.fit());
    on("help", () => byId("keys").showModal());
    document.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.layout()).observe(byId("stage"));
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
  }

  recolour() {
    readPalette();
    for (const sign of document.querySelectorAll("canvas.glyph")) sign.repaint();
    this.layout();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || byId("keys").open) return;
    const typing = event.target instanceof HTMLSelectElement;
    if (typing && event.key !== "Escape") return;
    const jump = event.shiftKey ? 10 : 1, robots = this.active.trace.R;
    const acts = {
      " ": () => this.toggle(), ArrowLeft: () => this.step(-jump), ArrowRight: () => this.step(jump), Home: () => this.go(0), End: () => this.go(this.last),
      "[": () => this.event(-1), "]": () => this.event(1), "+": () => this.faster(1), "=": () => this.faster(1), "-": () => this.faster(-1),
      n: () => this.select((this.selected + 1) % robots), p: () => this.select((Math.max(0, this.selected) + robots - 1) % robots),
      Escape: () => this.select(-1), 0: () => this.fit(), "?": () => byId("keys").showModal(),
    };
    for (let i = 1; i <= Math.min(9, this.panels.length); i++) acts[i] = () => this.look(i - 1);
    const act = Object.hasOwn(acts, event.key) && acts[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  listen(panel, i) {
    const { canvas, scene, tip } = panel, held = new Map();
    let dragged = false;
    const at = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
    panel.head.addEventListener("click", () => this.look(i));
    canvas.addEventListener("pointerdown", (event) => { held.set(event.pointerId, at(event)); dragged = false; });
    canvas.addEventListener("pointermove", (event) => {
      const [x, y] = at(event), from = held.get(event.pointerId);
      if (from) {
        if (!dragged && Math.hypot(x - from[0], y - from[1]) < 5) return;
        if (this.view.zoom > 1) {
          if (!dragged) canvas.setPointerCapture(event.pointerId);
          this.view.pan(x - from[0], y - from[1], scene.width, scene.height);
          held.set(event.pointerId, [x, y]);
          this.redraw();
        }
        dragged = true;
      }
      const r = scene.robotAt(x, y), node = r < 0 ? scene.nodeAt(x, y) : -1;
      tip.hidden = r < 0 && node < 0;
      if (tip.hidden) return;
      tip.textContent = r >= 0 ? `robot ${r}, ${panel.trace.kinds[panel.trace.kindOf[r]].name}` : panel.trace.building.label(node);
      tip.style.left = `${Math.min(x + 12, scene.width - 130)}px`;
      tip.style.top = `${Math.max(0, y - 26)}px`;
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    canvas.addEventListener("pointerleave", () => { tip.hidden = true; });
    canvas.addEventListener("click", (event) => {
      if (dragged) return;
      const r = scene.robotAt(...at(event));
      this.look(i);
      this.select(r);
    });
    canvas.addEventListener("dblclick", () => this.fit());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.view.zoomAt(Math.exp(-event.deltaY / 400), ...at(event), scene.width, scene.height);
      this.redraw();
    }, { passive: false });
  }

  /** Arrange the panels so that the plan is as large as it can be. */
  layout() {
    const stage = byId("stage"), { aspect } = this.view, n = this.panels.length;
    if (NARROW.matches) {
      stage.style.gridTemplateColumns = "";
      const width = stage.clientWidth;
      for (const panel of this.panels) panel.plan.style.flex = `0 0 ${Math.round(Math.min(width / aspect + 40, window.innerHeight * (n > 1 ? 0.5 : 0.62)))}px`;
    } else {
      const scale = (columns) => {
        const height = stage.clientHeight / Math.ceil(n / columns) - 100, width = stage.clientWidth / columns - 26;
        return Math.min(width, height * aspect);
      };
      let best = 1;
      for (let columns = 2; columns <= n; columns++) if (scale(columns) > scale(best)) best = columns;
      stage.style.gridTemplateColumns = `repeat(${best}, minmax(0, 1fr))`;
      for (const panel of this.panels) panel.plan.style.flex = "";
    }
    this.seat();
    for (const { plan, scene } of this.panels) scene.resize(plan.clientWidth, plan.clientHeight);
    this.timeline.draw();
    this.redraw();
  }

  // --- what people do ---

  toggle() {
    if (!this.playing && this.time >= this.last) this.time = 0;
    this.playing = !this.playing;
    document.body.classList.toggle("playing", this.playing);
    byId("play").setAttribute("aria-label", this.playing ? "Pause" : "Play");
    this.clock = performance.now();
    this.redraw();
  }

  pause() { if (this.playing) this.toggle(); }

  go(time) {
    this.time = Math.max(0, Math.min(this.last, time));
    for (const { scene } of this.panels) scene.pointed = -1;
    this.redraw();
  }

  step(by) {
    this.pause();
    this.go((by > 0 ? Math.floor(this.time) : Math.ceil(this.time)) + by);
  }

  faster(by) {
    this.speed = SPEEDS[Math.max(0, Math.min(SPEEDS.length - 1, SPEEDS.indexOf(this.speed) + by))];
    byId("speed").value = this.speed;
  }

  look(i) {
    this.active = this.panels[i];
    this.panels.forEach((panel, j) => {
      panel.element.classList.toggle("active", i === j);
      panel.scene.selected = i === j ? this.selected : -1;
    });
    this.log.fill();
    this.seat();
    this.redraw();
  }

  select(r) {
    this.selected = r;
    for (const panel of this.panels) panel.scene.selected = panel === this.active ? r : -1;
    this.seat();
    this.redraw();
  }

  /** Where there is no room for a column, what a robot thinks stands below its panel. */
  seat() {
    const { element } = this.inspector, wanted = NARROW.matches ? this.active.element : byId("log");
    if (NARROW.matches && wanted.nextSibling !== element) wanted.after(element);
    else if (!NARROW.matches && wanted.previousElementSibling !== element) wanted.before(element);
  }

  visit(event) {
    this.pause();
    this.go(event.t);
    this.active.scene.pointed = event.node;
    if (event.robots.length === 1) this.select(event.robots[0]);
    this.redraw();
  }

  /** To the next or previous event that the log shows. */
  event(by) {
    const now = Math.floor(this.time), { events } = this.log;
    const next = by > 0 ? events.find((e) => e.t > now) : events.findLast((e) => e.t < now);
    if (next) this.visit(next);
  }

  fit() {
    this.view.fit();
    this.redraw();
  }

  // --- the clock ---

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame((now) => {
      this.waiting = false;
      if (this.playing) {
        this.time = Math.min(this.last, this.time + (Math.min(250, Math.max(0, now - this.clock)) / 1000) * this.speed);
        this.clock = now;
      }
      this.show();
      if (this.playing && this.time >= this.last) this.toggle();
      if (this.playing) this.redraw();
    });
  }

  show() {
    document.body.classList.toggle("zoomed", this.view.zoom > 1);
    for (const panel of this.panels) panel.show(this.time);
    this.timeline.show(this.time);
    const t = Math.floor(this.time);
    if (t !== this.shown) {
      byId("scrub").value = t;
      byId("step").replaceChildren(`step ${t} `, make("small", {}, `of ${this.last}`));
      this.log.show(t);
      this.shown = t;
    }
    this.inspector.show(t);
  }
}

/** Whether nobody has opened a replay here before; browsers that keep nothing say yes every time. */
function firstVisit() {
  try {
    const before = localStorage.getItem("tasklift-replay");
    localStorage.setItem("tasklift-replay", "seen");
    return before === null;
  } catch {
    return true;
  }
}

/** Read the replay in the page and start it; an address that ends in #120 opens it, paused, at step 120. */
async function start() {
  const message = byId("message");
  try {
    readPalette();
    const player = new Player(await readReplay(byId("data").textContent));
    message.hidden = true;
    byId("player").hidden = false;
    player.look(0);
    player.layout();
    const asked = /^#(\d+)$/.exec(location.hash);
    if (asked) player.go(Number(asked[1]));
    else if (!window.matchMedia("(prefers-reduced-motion: reduce)").matches) player.toggle();
    window.tasklift = player; // for the console, and for tests
  } catch (error) {
    message.textContent = error instanceof Unreadable ? error.message : `The replay is damaged: ${error.message}`;
    message.hidden = false;
    byId("player").hidden = true;
  }
}

start();

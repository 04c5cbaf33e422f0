// How a moment of a trace is drawn on a canvas. World coordinates are metres, y up; the view turns them into pixels.

const palette = {};

/** Read the colours from the style sheet, so that canvas and page always agree. */
function readPalette() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["ground", "ghost-floor", "ghost-wall", "floor", "wall", "room", "searched", "door", "mark", "ink", "soft", "line",
    "kind0", "kind1", "kind2", "kind3", "alert", "danger", "safe", "paper", "accent"]) {
    palette[name] = style.getPropertyValue(`--${name}`).trim();
  }
}

/** Offsets of n robots that stand together, in robot widths: a ring up to six, then a honeycomb. */
const honeycomb = [];
function offsets(n) {
  if (n === 1) return [[0, 0]];
  if (n <= 6) {
    const radius = 0.56 / Math.sin(Math.PI / n);
    return Array.from({ length: n }, (_, i) => [radius * Math.sin((2 * Math.PI * i) / n), radius * Math.cos((2 * Math.PI * i) / n)]);
  }
  for (let reach = 2 + Math.ceil(Math.sqrt(n)); honeycomb.length < n;) {
    honeycomb.length = 0;
    for (let row = -reach; row <= reach; row++) {
      for (let column = -reach; column <= reach; column++) honeycomb.push([1.1 * (column + (row & 1) / 2), 0.95 * row]);
    }
    honeycomb.sort((p, q) => Math.hypot(...p) - Math.hypot(...q));
  }
  return honeycomb.slice(0, n);
}

const memo = new Map();
function cluster(n) {
  if (!memo.has(n)) {
    const places = offsets(n);
    memo.set(n, { places, radius: Math.max(...places.map((p) => Math.hypot(...p))) + 0.6 });
  }
  return memo.get(n);
}

/** Pan and zoom, shared by all panels: they show the same building. */
class View {
  constructor(building) {
    const sketch = () => [...building.outline, ...[...building.floor.values()].flat()];
    [this.left, this.right, this.low, this.high] = boxOf(building.plan ? building.plan.corners : sketch());
    this.aspect = Math.max(0.2, Math.min(5, (this.right - this.left) / (this.high - this.low)));
    this.version = 0;
    this.fit();
  }

  fit() {
    this.zoom = 1;
    this.x = (this.left + this.right) / 2;
    this.y = (this.low + this.high) / 2;
    this.version++;
  }

  scale(width, height) {
    const room = 26; // pixels kept free all round, for teams at the edge and the scale bar
    return this.zoom * Math.max(0.01, Math.min((width - room) / (this.right - this.left), (height - 2 * room) / (this.high - this.low)));
  }

  /** Zoom by a factor, keeping the world point under (px, py) of a width × height canvas. */
  zoomAt(factor, px, py, width, height) {
    const before = this.scale(width, height);
    this.zoom = Math.max(1, Math.min(40, this.zoom * factor));
    const after = this.scale(width, height);
    this.x += (px - width / 2) * (1 / before - 1 / after);
    this.y -= (py - height / 2) * (1 / before - 1 / after);
    if (this.zoom === 1) this.fit();
    this.version++;
  }

  pan(dx, dy, width, height) {
    const scale = this.scale(width, height);
    this.x = Math.max(this.left, Math.min(this.right, this.x - dx / scale));
    this.y = Math.max(this.low, Math.min(this.high, this.y + dy / scale));
    this.version++;
  }
}

function pathOf(polylines, closed) {
  const path = new Path2D();
  for (const line of polylines) {
    line.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
    if (closed) path.closePath();
  }
  return path;
}

/** The plan of a building as paths, made once for all panels. */
class Plan {
  constructor(building) {
    this.outline = pathOf([building.outline], true);
    this.corridors = pathOf(building.corridors, true);
    this.walls = pathOf(building.walls, false);
    this.picture = building.plan;
    this.edges = building.lines.map((line) => pathOf([line], false));
    // a door is a bar across the way from one neighbour to the next
    this.bars = building.position.map((here, node) => {
      if (building.class[node] < 2) return null;
      const ways = building.neighbours[node].map((other) => building.edgeBetween.get(node * building.n + other));
      const [p, q] = [...ways.map((e) => (building.edges[e][0] === node ? building.lines[e][1] : building.lines[e].at(-2))), here];
      const size = Math.hypot(p[0] - q[0], p[1] - q[1]) || 1;
      const half = Math.max(0.4, Math.min(...ways.map((e) => building.width[e])) / 2);
      return [-(p[1] - q[1]) / size * half, (p[0] - q[0]) / size * half];
    });
    if (this.picture) this.bars.forEach((bar, node) => { if (bar) this.picture.shut(building.position[node], bar); });
    const areas = [...building.floor].map(([node, ring]) => {
      const found = this.picture && this.picture.room(building.position[node], building.area[node]);
      return [node, found || { path: pathOf([ring], true), box: boxOf(ring) }];
    });
    this.rooms = new Map(areas.map(([node, { path }]) => [node, path]));
    this.boxes = new Map(areas.map(([node, { box }]) => [node, box]));
  }
}

/** One canvas with one trace. */
class Scene {
  constructor(canvas, trace, view, plan) {
    Object.assign(this, { canvas, trace, view, plan, width: 0, height: 0, drawn: [], selected: -1, pointed: -1 });
    this.pen = canvas.getContext("2d");
    this.ghost = document.createElement("canvas");
    this.full = document.createElement("canvas");
    this.mask = document.createElement("canvas");
    this.shown = document.createElement("canvas"); // in the page, below `canvas`: it changes less often
    canvas.before(this.shown);
    this.knownAt = 0; // the frame that `known` stands for
    this.known = new Uint8Array(trace.building.e);
    this.sprites = new Map();
  }

  resize(width, height) {
    const ratio = Math.min(3, window.devicePixelRatio || 1);
    if (width === this.width && height === this.height && ratio === this.ratio) return;
    Object.assign(this, { width, height, ratio });
    for (const canvas of [this.canvas, this.ghost, this.full, this.mask, this.shown]) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    this.layers = null;
  }

  toScreen(x, y) { return [this.width / 2 + (x - this.view.x) * this.k, this.height / 2 - (y - this.view.y) * this.k]; }

  /** Set a context to world coordinates. */
  world(pen) {
    const { k, ratio } = this;
    pen.setTransform(k * ratio, 0, 0, -k * ratio, ratio * (this.width / 2 - this.view.x * k), ratio * (this.height / 2 + this.view.y * k));
  }

  screen(pen) { pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0); }

  /** The plan twice: dimmed, as nobody in the team knows it, and as it looks when known. */
  drawLayers() {
    this.k = this.view.scale(this.width, this.height);
    const px = 1 / this.k;
    for (const [canvas, known] of [[this.ghost, false], [this.full, true]]) {
      const pen = canvas.getContext("2d");
      pen.setTransform(1, 0, 0, 1, 0, 0);
      pen.clearRect(0, 0, canvas.width, canvas.height);
      this.world(pen);
      if (this.plan.picture) {
        this.plan.picture.draw(pen, known ? palette.floor : palette["ghost-floor"], known ? palette.wall : palette["ghost-wall"]);
        pen.globalCompositeOperation = "source-atop"; // the rest is of the same colours, and on the plan
      } else if (!known) {
        pen.fillStyle = palette.ground;
        pen.fill(this.plan.outline);
      }
      pen.fillStyle = known ? palette.floor : palette["ghost-floor"];
      pen.fill(this.plan.corridors, "evenodd");
      if (known) pen.fillStyle = palette.room;
      for (const room of this.plan.rooms.values()) pen.fill(room);
      pen.strokeStyle = known ? palette.wall : palette["ghost-wall"];
      pen.lineWidth = (known ? 1.7 : 1) * px;
      pen.lineJoin = "round";
      pen.stroke(this.plan.walls);
      pen.globalCompositeOperation = "source-over";
    }
    const pen = this.ghost.getContext("2d");
    this.screen(pen);
    this.plan.bars.forEach((bar, node) => { if (bar) this.feature(pen, node, palette["ghost-wall"], false); });
  }

  /** Bring `known` to frame t; every change is its own reversal. */
  seek(t) {
    const { changes } = this.trace;
    for (; this.knownAt < t; this.knownAt++) for (const e of changes[this.knownAt + 1]) this.known[e] ^= 1;
    for (; this.knownAt > t; this.knownAt--) for (const e of changes[this.knownAt]) this.known[e] ^= 1;
  }

  /** 1: the team (or the selected robot) knows the corridor; 0.4: only robots that were lost saw it; 0: nobody. */
  knowledge(edge, t) {
    const { trace } = this;
    if (this.selected >= 0) {
      const learned = trace.learned[this.selected * trace.building.e + edge];
      if (learned >= 0 && learned <= t) return 1;
      return this.known[edge] ? 0.4 : 0;
    }
    if (this.known[edge]) return 1;
    return trace.visited[edge] >= 0 && trace.visited[edge] <= t ? 0.4 : 0;
  }

  /**
   * The known part of the full plan over the dimmed one, until something changes. Where the team has only learned
   * since frame `since`, just that is added.
   */
  drawKnown(t, since) {
    const { building, changes } = this.trace, pen = this.mask.getContext("2d"), px = 1 / this.k;
    let edges = building.edges.keys();
    if (since >= 0) {
      edges = [];
      for (let f = since + 1; f <= t; f++) edges.push(...changes[f]);
    } else {
      pen.setTransform(1, 0, 0, 1, 0, 0);
      pen.clearRect(0, 0, this.mask.width, this.mask.height);
      this.reached = new Uint8Array(building.n);
      this.showRoom(pen, building.start);
    }
    this.world(pen);
    pen.strokeStyle = pen.fillStyle = "#000";
    pen.lineCap = "square";
    const faint = [], clear = [];
    for (const e of edges) {
      const knowledge = this.knowledge(e, t);
      if (knowledge > 0) (knowledge === 1 ? clear : faint).push(e);
    }
    for (const [list, alpha] of [[faint, 0.45], [clear, 1]]) {
      pen.globalAlpha = alpha;
      for (const e of list) {
        pen.lineWidth = building.width[e] + 3 * px;
        pen.stroke(this.plan.edges[e]);
      }
    }
    pen.globalAlpha = 1;
    for (const e of [...faint, ...clear]) for (const node of building.edges[e]) this.showRoom(pen, node);
    const shown = this.shown.getContext("2d");
    shown.globalCompositeOperation = "copy";
    shown.drawImage(this.mask, 0, 0);
    shown.globalCompositeOperation = "source-in";
    shown.drawImage(this.full, 0, 0);
    shown.globalCompositeOperation = "destination-over";
    shown.drawImage(this.ghost, 0, 0);
  }

  /** Somebody has been at a node: its room, if it is one, is no longer dim. */
  showRoom(pen, node) {
    const room = this.plan.rooms.get(node);
    if (room && !this.reached[node]) {
      this.world(pen);
      pen.lineWidth = 3 / this.k;
      pen.fill(room);
      pen.stroke(room);
    }
    this.reached[node] = 1;
  }

  /** Draw the moment `time` (steps, with a fraction). */
  draw(time) {
    const { trace, pen } = this;
    time = Math.min(time, trace.F - 1);
    const t = Math.floor(time);
    const stamp = `${this.view.version} ${this.width} ${this.height} ${this.ratio} ${palette.paper}`;
    const fresh = this.layers !== stamp;
    if (fresh) { this.drawLayers(); this.layers = stamp; }
    const before = this.knownAt;
    this.seek(t);
    if (fresh || t < before || this.selected >= 0 || this.shownFor !== this.selected) this.drawKnown(t, -1);
    else if (t > before) {
      const changed = trace.changes.slice(before + 1, t + 1).flat();
      if (changed.length > 0) this.drawKnown(t, changed.every((e) => this.known[e]) ? before : -1);
    }
    this.shownFor = this.selected;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.drawDiscoveries(time, t);
    this.drawRooms(t);
    this.screen(pen);
    this.drawStart();
    this.drawFeatures(t);
    this.drawRipples(time, t);
    this.drawFallen(t);
    this.drawHostiles(t);
    this.place(time, t);
    this.drawTrails(time, t);
    this.drawGoals(t);
    this.drawTeams();
    this.drawRobots();
    this.drawScale();
  }

  /** Corridors that have just become known glow for a moment. */
  drawDiscoveries(time, t) {
    const { pen, trace } = this;
    if (this.selected >= 0) return;
    this.world(pen);
    pen.strokeStyle = palette.accent;
    pen.lineCap = "butt";
    for (let f = Math.max(1, t - 5); f <= t; f++) {
      pen.globalAlpha = 0.35 * Math.max(0, 1 - (time - f) / 6);
      for (const e of trace.changes[f]) {
        if (!this.known[e]) continue;
        pen.lineWidth = trace.building.width[e] * 0.8;
        pen.stroke(this.plan.edges[e]);
      }
    }
    pen.globalAlpha = 1;
  }

  /** Rooms fill from below as they are searched. */
  drawRooms(t) {
    const { pen, trace } = this, { building } = trace;
    for (const [node, room] of this.plan.rooms) {
      const i = building.roomIndex.get(node) * trace.F;
      const whole = trace.unsearched[i], left = trace.unsearched[i + t];
      if (left === whole) continue;
      const [west, east, low, high] = this.plan.boxes.get(node), share = 1 - left / whole;
      pen.save();
      this.world(pen);
      pen.clip(room);
      pen.fillStyle = palette.searched;
      pen.globalAlpha = this.reached[node] ? 0.9 : 0.4;
      pen.fillRect(building.position[node][0] - 1e4, low, 2e4, share * (high - low));
      pen.restore();
      const [x, y] = this.toScreen((west + east) / 2, (low + high) / 2);
      this.screen(pen);
      if (left === 0) this.check(x, y, Math.min(9, Math.max(4, 0.2 * this.k * (high - low))));
    }
  }

  check(x, y, size) {
    const { pen } = this;
    pen.strokeStyle = palette.safe;
    pen.lineWidth = Math.max(1.6, size / 3);
    pen.lineCap = pen.lineJoin = "round";
    pen.beginPath();
    pen.moveTo(x - size * 0.7, y);
    pen.lineTo(x - size * 0.15, y + size * 0.55);
    pen.lineTo(x + size * 0.75, y - size * 0.6);
    pen.stroke();
  }

  drawStart() {
    const { pen } = this, [x, y] = this.toScreen(...this.trace.building.position[this.trace.building.start]);
    pen.strokeStyle = palette.soft;
    pen.lineWidth = 1.4;
    pen.setLineDash([2, 3]);
    pen.beginPath();
    pen.arc(x, y, Math.max(7, 0.9 * this.k), 0, 7);
    pen.stroke();
    pen.setLineDash([]);
  }

  /** What is known of features; the dim plan has the others. What is resolved steps back. */
  drawFeatures(t) {
    const { pen, trace } = this, { building } = trace;
    for (let node = 0; node < building.n; node++) {
      if (!this.reached[node] || !this.plan.bars[node]) continue;
      const resolved = trace.resolved[node] >= 0 && trace.resolved[node] <= t;
      this.feature(pen, node, resolved ? palette.mark : palette.door, resolved);
    }
    if (this.pointed >= 0) {
      const [x, y] = this.toScreen(...building.position[this.pointed]);
      pen.strokeStyle = palette.accent;
      pen.lineWidth = 2;
      pen.beginPath();
      pen.arc(x, y, 14, 0, 7);
      pen.stroke();
    }
  }

  /** A door is a bar across the corridor, with a gap once it is open; any other feature a dot. */
  feature(pen, node, colour, open) {
    const { building } = this.trace, [x, y] = this.toScreen(...building.position[node]);
    if (x < -20 || y < -20 || x > this.width + 20 || y > this.height + 20) return;
    pen.strokeStyle = pen.fillStyle = colour;
    pen.beginPath();
    if (building.classNames[building.class[node]] === "door") {
      const bar = this.plan.bars[node], [dx, dy] = [bar[0] * this.k, -bar[1] * this.k], gap = open ? 0.55 : 0;
      pen.lineCap = "butt";
      pen.lineWidth = open ? 2 : Math.max(3, Math.min(5, 0.45 * this.k));
      for (const side of [-1, 1]) {
        pen.moveTo(x + side * dx, y + side * dy);
        pen.lineTo(x + side * gap * dx, y + side * gap * dy);
      }
      pen.stroke();
    } else {
      pen.arc(x, y, open ? 1.6 : 2.4, 0, 7);
      pen.fill();
    }
  }

  /** Alerts spread as rings, to the range at which they are heard; a failed attack is heard everywhere. */
  drawRipples(time, t) {
    const { pen, trace } = this;
    for (const event of trace.events.slice(upTo(trace.events, t - 10), upTo(trace.events, t))) {
      const age = (time - event.t) / 10;
      const fails = event.type === "attack" && trace.failed.some((f) => f.frame === event.t && f.node === event.node);
      if (age >= 1 || !(event.type === "alert" || fails)) continue;
      const range = fails ? 40 : trace.reading.alert_range_m;
      const [x, y] = this.toScreen(...trace.building.position[event.node]);
      pen.strokeStyle = pen.fillStyle = fails ? palette.danger : palette.alert;
      pen.beginPath();
      pen.arc(x, y, range * this.k * Math.sqrt(age), 0, 7);
      pen.globalAlpha = 0.1 * (1 - age);
      pen.fill();
      pen.globalAlpha = 0.9 * (1 - age);
      pen.lineWidth = 2;
      pen.stroke();
      pen.globalAlpha = 1;
    }
  }

  /** A cross for every robot that was lost, where it happened. */
  drawFallen(t) {
    const { pen, trace } = this, heaps = new Map();
    for (let r = 0; r < trace.R; r++) {
      if (trace.alive(r, t)) continue;
      const node = trace.place[r * trace.F + trace.died[r]];
      heaps.has(node) ? heaps.get(node).push(r) : heaps.set(node, [r]);
    }
    for (const members of heaps.values()) {
      const [x, y] = this.toScreen(trace.x[t * trace.R + members[0]], trace.y[t * trace.R + members[0]]);
      const size = this.size() * 0.65, first = Math.max(18, 3 * size), around = Math.floor((2 * Math.PI * first) / (3.2 * size));
      members.forEach((r, i) => { // in rings around the place, from the top, so that the hostile stays in sight
        const ring = Math.floor(i / around), angle = (2 * Math.PI * (i % around)) / around, radius = first + ring * 3.2 * size;
        const [cx, cy] = [x + radius * Math.sin(angle), y - radius * Math.cos(angle)];
        this.cross(cx, cy, size, palette.paper, 4.4);
        this.cross(cx, cy, size, palette[`kind${trace.kindOf[r] % 4}`], 2);
      });
    }
  }

  cross(x, y, size, colour, width) {
    const { pen } = this;
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.lineCap = "round";
    pen.beginPath();
    pen.moveTo(x - size, y - size);
    pen.lineTo(x + size, y + size);
    pen.moveTo(x + size, y - size);
    pen.lineTo(x - size, y + size);
    pen.stroke();
  }

  /** Hidden: a faint dashed diamond (only we see it); suspected: amber; known: red; destroyed: green and ticked. */
  drawHostiles(t) {
    const { pen, trace } = this;
    for (const hostile of trace.hostiles) {
      const standing = trace.standing(hostile, t), [x, y] = this.toScreen(...trace.building.position[hostile.node]);
      const there = trace.teams[t].find((members) => trace.at("place", members[0], t) === hostile.node);
      const crowd = there ? cluster(there.length).radius * this.size() * 2.8 * this.tight(there.length) + 3 : 0;
      const size = Math.max(crowd, 9, Math.min(13, 1.1 * this.k)); // around the robots that stand there
      const colour = { hidden: palette.soft, suspected: palette.alert, known: palette.danger, destroyed: palette.safe }[standing];
      pen.beginPath();
      pen.moveTo(x, y - size);
      pen.lineTo(x + size, y);
      pen.lineTo(x, y + size);
      pen.lineTo(x - size, y);
      pen.closePath();
      pen.globalAlpha = standing === "hidden" ? 0.25 : 0.9;
      pen.fillStyle = standing === "known" && !crowd ? palette.danger : palette.paper;
      pen.fill();
      pen.globalAlpha = 1;
      pen.lineWidth = crowd ? 3 : 2;
      pen.strokeStyle = colour;
      pen.setLineDash(standing === "hidden" ? [3, 2.5] : []);
      pen.stroke();
      pen.setLineDash([]);
      if (crowd) continue;
      if (standing === "destroyed") this.check(x, y, size * 0.5);
      else {
        pen.fillStyle = standing === "known" ? palette.paper : colour;
        pen.font = `bold ${Math.round(size * 1.15)}px system-ui, sans-serif`;
        pen.textAlign = "center";
        pen.textBaseline = "middle";
        pen.fillText(standing === "known" ? "!" : "?", x, y + 0.5);
      }
    }
  }

  /** Half a robot's width in pixels. */
  size() {
    const crowd = this.trace.R > 60;
    return Math.max(crowd ? 2.2 : 4.6, Math.min(9, (crowd ? 0.34 : 0.42) * this.k));
  }

  /** Where everybody is on the screen: between two frames, on the straight line. */
  place(time, t) {
    const { trace } = this, { R, F } = trace, next = Math.min(t + 1, F - 1), share = time - t, size = this.size();
    this.drawn = [];
    for (let r = 0; r < R; r++) {
      if (!trace.alive(r, t)) continue;
      const dies = !trace.alive(r, next);
      const spot = (f) => {
        const i = f * R + r, n = trace.teams[f][trace.team[i]].length, { places } = cluster(n), tight = this.tight(n);
        const [x, y] = this.toScreen(trace.x[i], trace.y[i]);
        return [x + places[trace.slot[i]][0] * size * 2 * tight, y - places[trace.slot[i]][1] * size * 2 * tight];
      };
      let [x, y] = spot(t);
      if (share > 0 && !dies) {
        const [nx, ny] = spot(next);
        x += share * (nx - x);
        y += share * (ny - y);
      }
      this.drawn.push({ r, x, y, frame: t });
    }
    this.share = share;
    this.frame = t;
  }

  /** Large crowds stand closer. */
  tight(n) { return n > 40 ? 0.7 : 1; }

  drawTrails(time, t) {
    const { pen, trace } = this, { R } = trace, length = 9;
    if (t === 0) return;
    pen.lineCap = pen.lineJoin = "round";
    pen.lineWidth = R > 60 ? 1.2 : 2;
    const now = new Map(this.drawn.map((d) => [d.r, d]));
    for (let kind = 0; kind < trace.kinds.length; kind++) {
      pen.strokeStyle = palette[`kind${kind % 4}`];
      pen.globalAlpha = 0.28;
      pen.beginPath();
      for (const { r } of now.values()) {
        if (trace.kindOf[r] !== kind) continue;
        const first = Math.max(0, t - length);
        let [px, py] = [NaN, NaN];
        for (let f = first; f <= t; f++) {
          const x = trace.x[f * R + r], y = trace.y[f * R + r];
          if (x === px && y === py) continue;
          const [sx, sy] = this.toScreen(x, y);
          Number.isNaN(px) ? pen.moveTo(sx, sy) : pen.lineTo(sx, sy);
          [px, py] = [x, y];
        }
      }
      pen.stroke();
    }
    pen.globalAlpha = 1;
  }

  /** A line from every alerted team to what it is about. */
  drawGoals(t) {
    const { pen, trace } = this, { R } = trace;
    const where = new Map(this.drawn.map((d) => [d.r, d]));
    pen.setLineDash([5, 5]);
    pen.lineWidth = 1.3;
    for (const members of trace.teams[t]) {
      const r = members[0], level = trace.at("danger", r, t), node = trace.at("about", r, t);
      if (level === 0 || node < 0 || (R > 60 && r !== this.selected)) continue;
      const from = where.get(r), [x, y] = this.toScreen(...trace.building.position[node]);
      if (!from || Math.hypot(x - from.x, y - from.y) < 24) continue;
      pen.strokeStyle = level === 2 ? palette.danger : palette.alert;
      pen.globalAlpha = level === 2 ? 0.32 : 0.5;
      pen.beginPath();
      pen.moveTo(from.x, from.y);
      pen.lineTo(x, y);
      pen.stroke();
    }
    pen.globalAlpha = 1;
    pen.setLineDash([]);
  }

  /** A bubble around every team; solid where it has the weapons that a hostile needs. */
  drawTeams() {
    const { pen, trace, frame } = this, { R, F } = trace;
    const target = this.share > 0 ? Math.min(frame + 1, F - 1) : frame;
    const where = new Map(this.drawn.map((d) => [d.r, d]));
    for (const members of trace.teams[target]) {
      if (members.length < 2) continue;
      const home = trace.team[frame * R + members[0]];
      if (!members.every((r) => trace.team[frame * R + r] === home)) continue;
      let [x, y] = [0, 0];
      for (const r of members) { x += where.get(r).x; y += where.get(r).y; }
      x /= members.length;
      y /= members.length;
      const radius = cluster(members.length).radius * this.size() * 2 * this.tight(members.length) + 2;
      const ready = trace.armed(members) >= trace.weaponsNeeded;
      const level = trace.at("danger", members[0], target);
      const colour = level === 2 ? palette.danger : level === 1 ? palette.alert : palette.ink;
      pen.beginPath();
      pen.arc(x, y, radius, 0, 7);
      pen.fillStyle = palette.paper;
      pen.globalAlpha = 0.72;
      pen.fill();
      pen.globalAlpha = ready ? 0.85 : 0.35;
      pen.strokeStyle = colour;
      pen.lineWidth = ready ? 2 : 1.2;
      pen.stroke();
      pen.globalAlpha = 1;
      if (members.length > 7) {
        pen.font = "600 11px system-ui, sans-serif";
        pen.textAlign = "left";
        pen.textBaseline = "middle";
        pen.lineWidth = 3;
        pen.strokeStyle = palette.paper;
        pen.strokeText(String(members.length), x + radius + 3, y);
        pen.fillStyle = palette.ink;
        pen.fillText(String(members.length), x + radius + 3, y);
      }
    }
  }

  /** One kind of robot at one danger level, drawn once: one ring for suspected, a bold one for attacked. */
  sprite(kind, level, size) {
    const key = `${kind} ${level} ${size} ${this.ratio} ${palette.paper}`;
    if (!this.sprites.has(key)) {
      const half = Math.ceil(size + 5), width = 2 * half * this.ratio;
      const canvas = new OffscreenCanvas(width, width), pen = canvas.getContext("2d");
      pen.setTransform(this.ratio, 0, 0, this.ratio, half * this.ratio, half * this.ratio);
      pen.lineJoin = "round";
      if (level > 0) {
        pen.strokeStyle = level === 2 ? palette.danger : palette.alert;
        pen.lineWidth = level === 2 ? 2.6 : 1.8;
        pen.beginPath();
        pen.arc(0, 0, size + 2, 0, 7);
        pen.stroke();
      }
      robotShape(pen, this.trace.kinds, kind, 0, 0, size);
      this.sprites.set(key, { image: canvas.transferToImageBitmap(), half });
    }
    return this.sprites.get(key);
  }

  drawRobots() {
    const { pen, trace, frame, ratio } = this, size = this.size();
    const whole = (v) => (trace.R > 60 ? Math.round(v * ratio) / ratio : v); // crowds on whole pixels: much faster
    for (const { r, x, y } of this.drawn) {
      const { image, half } = this.sprite(trace.kindOf[r], trace.at("danger", r, frame), size);
      pen.drawImage(image, whole(x - half), whole(y - half), 2 * half, 2 * half);
      if (r === this.selected) {
        pen.strokeStyle = palette.accent;
        pen.lineWidth = 2.5;
        pen.beginPath();
        pen.arc(x, y, size + 6, 0, 7);
        pen.stroke();
      }
    }
  }

  drawScale() {
    const { pen } = this, rough = 90 / this.k, unit = 10 ** Math.floor(Math.log10(rough));
    const length = [5, 2, 1].map((m) => m * unit).find((m) => m <= rough), y = this.height - 12;
    pen.strokeStyle = palette.soft;
    pen.lineWidth = 2;
    pen.lineCap = "butt";
    pen.beginPath();
    pen.moveTo(12, y);
    pen.lineTo(12 + length * this.k, y);
    pen.stroke();
    pen.fillStyle = palette.soft;
    pen.font = "11px system-ui, sans-serif";
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.fillText(`${length} m`, 18 + length * this.k, y);
  }

  /** The robot under a point, or -1. */
  robotAt(px, py) {
    let best = -1, least = this.size() + 9;
    for (const { r, x, y } of this.drawn) {
      const distance = Math.hypot(x - px, y - py);
      if (distance < least) { best = r; least = distance; }
    }
    return best;
  }

  /** The room or feature under a point, or -1. */
  nodeAt(px, py) {
    const { position } = this.trace.building;
    let best = -1, least = 14;
    position.forEach((p, node) => {
      const [x, y] = this.toScreen(...p), distance = Math.hypot(x - px, y - py);
      if (distance < least) { best = node; least = distance; }
    });
    return best;
  }
}

/** Unarmed kinds are round, then square; armed ones triangles, then diamonds. Shape tells as much as colour. */
function robotShape(pen, kinds, kind, x, y, size) {
  const same = kinds.slice(0, kind).filter((k) => k.armed === kinds[kind].armed).length % 2;
  pen.beginPath();
  if (kinds[kind].armed && same === 0) {
    pen.moveTo(x, y - size * 1.2);
    pen.lineTo(x + size * 1.1, y + size * 0.8);
    pen.lineTo(x - size * 1.1, y + size * 0.8);
    pen.closePath();
  } else if (kinds[kind].armed) {
    pen.moveTo(x, y - size * 1.15);
    pen.lineTo(x + size * 1.15, y);
    pen.lineTo(x, y + size * 1.15);
    pen.lineTo(x - size * 1.15, y);
    pen.closePath();
  } else if (same === 0) pen.arc(x, y, size * 0.9, 0, 7);
  else pen.rect(x - size * 0.8, y - size * 0.8, size * 1.6, size * 1.6);
  pen.fillStyle = palette[`kind${kind % 4}`];
  pen.fill();
  pen.strokeStyle = palette.paper;
  pen.lineWidth = Math.max(0.7, size / 5);
  pen.stroke();
}

"use strict";
// What a replay means. Nothing here draws. Arrays of a trace are robot by robot: [r * F + t] is robot r in frame t;
// what is worked out from them is frame by frame: [t * R + r].

/** A replay that cannot be shown; the message is for people. */
class Unreadable extends Error {}

function need(condition, message) {
  if (!condition) throw new Unreadable(message);
}

const FORMAT = "tasklift-replay", VERSION = 1;
const TYPES = { int8: Int8Array, int32: Int32Array, float64: Float64Array };
const LARGEST = 2e8; // entries of one array: beyond that a damaged size, not a replay

function finite(list, where, count, low = -1e9, high = 1e9) {
  need(Array.isArray(list) && list.length === count, `${where}: expected a list of ${count} numbers`);
  for (const v of list) need(typeof v === "number" && v >= low && v <= high, `${where}: ${String(v)} is no number from ${low} to ${high}`);
  return list;
}

function lines(list, where) {
  need(Array.isArray(list), `${where}: expected lines`);
  for (const line of list) {
    need(Array.isArray(line), `${where}: expected lines of points`);
    for (const point of line) finite(point, where, 2);
  }
  return list;
}

async function inflate(text, length, where) {
  need(typeof DecompressionStream === "function", "This browser cannot unpack the replay; use one from 2023 or later.");
  const damaged = `${where}: damaged or cut short`;
  let bytes;
  try { bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0)); } catch { throw new Unreadable(damaged); }
  const out = new Uint8Array(length);
  let filled = 0;
  try {
    const reader = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      if (filled + part.value.length > length) { filled = -1; reader.cancel(); break; }
      out.set(part.value, filled);
      filled += part.value.length;
    }
  } catch { throw new Unreadable(damaged); }
  need(filled === length, damaged);
  return out.buffer;
}

/** Unpack one array; every entry is a number from low to high. */
async function unpack(packed, where, shape, low, high) {
  need(packed && typeof packed.data === "string" && Object.hasOwn(TYPES, packed.type), `${where}: missing`);
  const count = shape.reduce((a, b) => a * b, 1);
  need(String(packed.shape) === String(shape) && count <= LARGEST, `${where}: expected the shape ${shape}, found ${String(packed.shape)}`);
  const Type = TYPES[packed.type];
  const values = new Type(await inflate(packed.data, count * Type.BYTES_PER_ELEMENT, where));
  const run = shape[shape.length - 1];
  if (packed.steps) for (let i = 0; i < count; i++) if (i % run) values[i] += values[i - 1];
  for (let i = 0; i < count; i++) {
    if (!(values[i] >= low && values[i] <= high)) throw new Unreadable(`${where}: ${values[i]} is not from ${low} to ${high}`);
  }
  return values;
}

/** The graph and its floor plan. */
class Building {
  constructor(b) {
    need(b && Array.isArray(b.kind) && b.kind.length >= 2, "building: expected at least two nodes");
    const n = this.n = b.kind.length;
    this.name = String(b.name);
    this.kind = finite(b.kind, "building, kind", n, 0, 2);
    this.class = finite(b.class, "building, class", n, 1, 99);
    this.kindNames = b.kind_names;
    this.classNames = b.class_names;
    need(Array.isArray(this.kindNames) && this.classNames && typeof this.classNames === "object", "building: names are missing");
    need(Array.isArray(b.position_m) && b.position_m.length === n, `building, position_m: expected ${n} points`);
    this.position = lines([b.position_m], "building, position_m")[0];
    need(Array.isArray(b.edges) && b.edges.length > 0, "building, edges: expected a list");
    const e = this.e = b.edges.length;
    this.edges = b.edges;
    for (const edge of b.edges) {
      finite(edge, "building, edges", 2, 0, n - 1);
      need(Number.isInteger(edge[0]) && Number.isInteger(edge[1]), "building, edges: expected whole numbers");
    }
    this.length = finite(b.length_m, "building, length_m", e, 0);
    this.cost = finite(b.cost_mm, "building, cost_mm", e, 1, 1e15);
    this.width = finite(b.width_m, "building, width_m", e, 0);
    const courses = b.course_m ?? b.edges.map(() => []);
    need(Array.isArray(courses) && courses.length === e, `building, course_m: expected ${e} lines`);
    lines(courses, "building, course_m");
    this.lines = b.edges.map(([a, z], i) => [this.position[a], ...courses[i], this.position[z]]);
    this.area = b.area_m2 ? finite(b.area_m2, "building, area_m2", n, 0) : [];
    this.plan = null; // the picture that the building was found in, if there is one
    [this.start] = finite([b.start], "building, start", 1, 0, n - 1);
    this.outline = lines([b.outline_m], "building, outline_m")[0];
    this.corridors = lines(b.corridors, "building, corridors");
    this.walls = lines(b.walls, "building, walls");
    this.rooms = this.kind.flatMap((kind, node) => (kind === 0 ? [node] : []));
    this.roomIndex = new Map(this.rooms.map((node, i) => [node, i]));
    this.floor = new Map(this.rooms.map((node) => [node, lines([b.rooms && b.rooms[node]], `building, room ${node}`)[0]]));
    this.neighbours = Array.from({ length: n }, () => []);
    this.edgeBetween = new Map();
    b.edges.forEach(([a, z], i) => {
      this.neighbours[a].push(z);
      this.neighbours[z].push(a);
      this.edgeBetween.set(a * n + z, i).set(z * n + a, i);
    });
  }

  /** What to call a node: "door 12". */
  label(node) {
    const kind = this.class[node] > 1 ? this.classNames[this.class[node]] : this.kindNames[this.kind[node]];
    return `${kind} ${node}`;
  }

  /** The corridor of a place under way, and its two ends in the direction of travel. */
  way(place) {
    const edge = (place - this.n) >> 1;
    const [a, z] = this.edges[edge];
    return (place - this.n) & 1 ? [edge, z, a] : [edge, a, z];
  }
}

/** The point of a line that lies this share of its length from its beginning. */
function along(line, share) {
  const sizes = line.slice(1).map((p, i) => Math.hypot(p[0] - line[i][0], p[1] - line[i][1]));
  let left = share * sizes.reduce((a, b) => a + b, 0), i = 0;
  for (; i < sizes.length - 1 && left > sizes[i]; i++) left -= sizes[i];
  const part = sizes[i] > 0 ? left / sizes[i] : 0;
  return [0, 1].map((axis) => line[i][axis] + part * (line[i + 1][axis] - line[i][axis]));
}

/** A variable's value, as a reader would say it. */
function told(variable, index) {
  return variable.labels[index] ?? variable.values[index];
}

function digits(variables, index) {
  const found = [];
  for (let i = variables.length - 1; i >= 0; i--) {
    const n = variables[i].values.length;
    found[i] = index % n;
    index = Math.floor(index / n);
  }
  return found;
}

const sizeOf = (variables) => variables.reduce((n, v) => n * v.values.length, 1);

/** One trial: what is in the file, and what follows from it. */
class Trace {
  static async load(doc, building, kinds, tasks, where) {
    const trace = new Trace();
    need(doc && typeof doc === "object" && doc.arrays, `${where}: nothing there`);
    const F = doc.frames, N = building.n, E = building.e;
    const R = kinds.reduce((n, kind) => n + kind.number, 0);
    need(Number.isInteger(F) && F >= 1 && F < 1e7, `${where}: ${String(F)} frames`);
    need(Object.hasOwn(tasks, doc.task), `${where}: its task is missing`);
    const task = tasks[doc.task], A = task.columns.length;
    const S = doc.arrays.weights && doc.arrays.weights.shape && doc.arrays.weights.shape[0];
    need(Number.isInteger(S) && S >= 1, `${where}: its weights are missing`);
    const get = (name, shape, low, high) => unpack(doc.arrays[name], `${where}, ${name}`, shape, low, high);
    Object.assign(trace, {
      building, kinds, task, F, R, A, label: String(doc.label), meaning: typeof doc.meaning === "string" ? doc.meaning : "", seed: String(doc.seed), trial: doc.trial, success: doc.success === true,
      limit: doc.limit, weaponsNeeded: doc.weapons_needed, reading: doc.reading, learner: doc.learner,
      weights: await get("weights", [S, A], 0, 1e300),
      signal: await get("signal", [S, A], -1e300, 1e300),
      died: await get("died", [R], -1, F),
      place: await get("place", [R, F], 0, N + 2 * E - 1),
      progress: await get("progress", [R, F], 0, 2 ** 31),
      danger: await get("danger", [R, F], 0, 2),
      about: await get("about", [R, F], -1, N - 1),
      input: await get("input", [R, F], -1, sizeOf(task.inputs) - 1),
      pair: await get("pair", [R, F], 0, S * A - 1),
      decided: await get("decided", [R, F], 0, 2),
      engaged: await get("engaged", [R, F], 0, 1),
      held: await get("held", [R, F], 0, 1),
      visited: await get("visited", [E], -1, F - 1),
      resolved: await get("resolved", [N], -1, F - 1),
      unsearched: await get("unsearched", [building.rooms.length, F], 0, 2 ** 31),
      messages: await get("messages", [1, F], 0, 2 ** 31),
      losses: await get("losses", [1, F], 0, 2 ** 31),
    });
    for (const name of ["limit", "weaponsNeeded"]) need(Number.isInteger(trace[name]), `${where}, ${name}: expected a whole number`);
    need(trace.reading && trace.learner, `${where}: its rules are missing`);
    for (const list of [doc.hostiles, doc.failed]) {
      need(Array.isArray(list), `${where}: its hostiles are missing`);
      for (const pair of list) finite(pair, `${where}, hostiles`, 2, -1, Math.max(N, F));
    }
    trace.hostiles = doc.hostiles.map(([node, destroyed]) => ({ node, destroyed }));
    trace.failed = doc.failed.map(([frame, node]) => ({ frame, node }));
    for (const { node } of [...trace.hostiles, ...trace.failed]) need(node >= 0 && node < N, `${where}: a hostile at no node`);
    trace.kindOf = kinds.flatMap((kind, i) => Array(kind.number).fill(i));
    trace.locate();
    trace.group();
    trace.pool();
    trace.count();
    trace.tell();
    return trace;
  }

  alive(r, t) { return this.died[r] < 0 || t < this.died[r]; }

  at(name, r, t) { return this[name][r * this.F + t]; }

  moves(r, t) {
    const { task } = this;
    const mv = task.outputs.findIndex((v) => v.name === "MV");
    const output = digits(task.outputs, task.columns[this.at("pair", r, t) % this.A]);
    return this.at("held", r, t) === 0 && (mv < 0 || task.outputs[mv].values[output[mv]] === "1");
  }

  /** Everyone's position (m) in every frame. */
  locate() {
    const { F, R, building: b } = this;
    this.x = new Float64Array(F * R);
    this.y = new Float64Array(F * R);
    for (let r = 0; r < R; r++) {
      for (let t = 0; t < F; t++) {
        const place = this.place[r * F + t];
        let [x, y] = b.position[Math.min(place, b.n - 1)];
        if (place >= b.n) {
          const [edge, from] = b.way(place);
          const share = Math.min(1, this.progress[r * F + t] / b.cost[edge]);
          [x, y] = along(b.lines[edge], from === b.edges[edge][0] ? share : 1 - share);
        }
        this.x[t * R + r] = x;
        this.y[t * R + r] = y;
      }
    }
  }

  /** Teams: robots at one node, or in one corridor, one way, equally far. The dead lie where they fell. */
  group() {
    const { F, R } = this;
    this.team = new Int32Array(F * R).fill(-1);
    this.slot = new Int32Array(F * R); // which member of its team a robot is
    this.teams = [];                   // frame by frame: the members of every team
    this.fallen = [];                  // robots by the node where they were lost
    for (let t = 0; t < F; t++) {
      const seen = new Map(), teams = [];
      for (let r = 0; r < R; r++) {
        if (!this.alive(r, t)) continue;
        const key = this.place[r * F + t] * 4294967296 + this.progress[r * F + t];
        if (!seen.has(key)) { seen.set(key, teams.length); teams.push([]); }
        const team = seen.get(key);
        this.team[t * R + r] = team;
        this.slot[t * R + r] = teams[team].push(r) - 1;
      }
      this.teams.push(teams);
    }
  }

  armed(members) { return members.filter((r) => this.kinds[this.kindOf[r]].armed).length; }

  /** Maps: a corridor enters on arrival, teams (or all) pool, what the lost had not told is lost with them. */
  pool() {
    const { F, R, building: b } = this, words = (b.e + 31) >> 5;
    const maps = new Uint32Array(R * words), together = new Uint32Array(words);
    let known = new Uint32Array(words);
    this.learned = new Int32Array(R * b.e).fill(-1); // frame in which robot r learned of corridor e: [r * E + e]
    this.changes = [[]];                             // frame by frame: corridors that the team got to know, or lost
    const eachBit = (word, w, act) => {
      for (let bits = word; bits; bits &= bits - 1) act(w * 32 + 31 - Math.clz32(bits & -bits));
    };
    for (let t = 1; t < F; t++) {
      for (let r = 0; r < R; r++) {
        const before = this.place[r * F + t - 1], now = this.place[r * F + t];
        if (before === now || now >= b.n || !this.alive(r, t)) continue;
        const edge = before >= b.n ? (before - b.n) >> 1 : b.edgeBetween.get(before * b.n + now);
        if (edge === undefined) throw new Unreadable(`${this.label}: robot ${r} jumps in step ${t}`);
        maps[r * words + (edge >> 5)] |= 1 << (edge & 31);
        if (this.learned[r * b.e + edge] < 0) this.learned[r * b.e + edge] = t;
      }
      const share = this.reading.share_map;
      const groups = share === "none" ? [] : share === "radio" ? [this.teams[t].flat()] : this.teams[t];
      for (const members of groups) {
        if (members.length < 2) continue;
        together.fill(0);
        for (const r of members) for (let w = 0; w < words; w++) together[w] |= maps[r * words + w];
        for (const r of members) {
          for (let w = 0; w < words; w++) {
            const fresh = together[w] & ~maps[r * words + w];
            if (fresh) eachBit(fresh, w, (edge) => { this.learned[r * b.e + edge] = t; });
            maps[r * words + w] = together[w];
          }
        }
      }
      const union = new Uint32Array(words), changed = [];
      for (const members of this.teams[t]) {
        for (const r of members) for (let w = 0; w < words; w++) union[w] |= maps[r * words + w];
      }
      for (let w = 0; w < words; w++) eachBit(union[w] ^ known[w], w, (edge) => changed.push(edge));
      known = union;
      this.changes.push(changed);
    }
  }

  /** The numbers of every frame. */
  count() {
    const { F, building: b } = this;
    this.explored = new Int32Array(F);
    for (const t of this.visited) if (t >= 0) this.explored[t]++;
    for (let t = 1; t < F; t++) this.explored[t] += this.explored[t - 1];
    this.living = this.teams.map((teams) => teams.reduce((n, members) => n + members.length, 0));
    this.searched = Array.from({ length: F }, (_, t) => b.rooms.reduce((n, _, i) => n + (this.unsearched[i * F + t] === 0), 0));
  }

  /** The numbers of one frame. */
  numbers(t) {
    const byKind = this.kinds.map(() => 0);
    for (const members of this.teams[t]) for (const r of members) byKind[this.kindOf[r]]++;
    return {
      step: t, explored: this.explored[t] / this.building.e, robots: this.living[t], byKind, teams: this.teams[t].length,
      losses: this.losses[t], messages: this.messages[t], searched: this.searched[t],
      hostiles: this.hostiles.filter((h) => h.destroyed < 0 || h.destroyed > t).length,
      outcome: t < this.F - 1 ? "" : this.success ? "done" : this.living[t] === 0 ? "all lost" : "out of time",
    };
  }

  /** How much the team knows of a hostile: hidden, suspected, known, destroyed. */
  standing(hostile, t) {
    if (hostile.destroyed >= 0 && hostile.destroyed <= t) return "destroyed";
    if (this.failed.some((f) => f.node === hostile.node && f.frame <= t)) return "known";
    for (let r = 0; r < this.R; r++) {
      if (this.alive(r, t) && this.at("danger", r, t) > 0 && this.at("about", r, t) === hostile.node) return "suspected";
    }
    return "hidden";
  }

  /** The last decision of robot r up to frame t, and the weights its draw was made from; null before the first. */
  decision(r, t) {
    const { F, R, A, learner } = this;
    let frame = Math.min(t, F - 1);
    while (frame > 0 && this.decided[r * F + frame] === 0) frame--;
    if (frame === 0) return null;
    let drawer = r;
    if (this.decided[r * F + frame] === 2) drawer = this.teams[frame - 1][this.team[(frame - 1) * R + r]][0];
    const weights = Float64Array.from(this.weights), used = new Set();
    const reinforce = (pair, signal) => { weights[pair] = Math.max(learner.floor, weights[pair] + signal); };
    for (let f = 1; f <= frame; f++) {
      for (let i = 0; i < R; i++) {
        if (f === frame && i === drawer) break;
        const pair = this.pair[i * F + f];
        if (this.decided[i * F + f] !== 1) continue;
        if (learner.learns && this.signal[pair] !== 0 && !(learner.once && used.has(pair))) reinforce(pair, this.signal[pair]);
        used.add(pair);
      }
      if (f === frame || !learner.learns || !learner.loss_signal) continue;
      for (let i = 0; i < R; i++) if (this.engaged[i * F + f]) reinforce(this.pair[i * F + f], learner.loss_signal);
    }
    const pair = this.pair[drawer * F + frame], row = Math.floor(pair / A);
    const heard = weights.subarray(row * A, row * A + A);
    return {
      frame, drawer, row, output: pair % A, input: this.input[drawer * F + frame], weights: heard,
      probabilities: chances(heard, learner.greedy), signal: learner.learns ? this.signal[pair] : 0,
      reasons: learner.learns ? this.task.signals.filter((s) => s.where.has(pair)) : [],
    };
  }

  /** Events in order of time. */
  tell() {
    const { F, R, building: b } = this, events = [];
    const add = (t, type, text, node = -1, robots = []) => events.push({ t, type, text, node, robots });
    const robots = (list) => (list.length === 1 ? `robot ${list[0]}` : `${list.length} robots`);
    const hostileAt = new Map(this.hostiles.map((h) => [h.node, h]));
    for (const { frame, node } of this.failed) add(frame, "attack", `Attack at ${b.label(node)} fails`, node);
    for (const { node, destroyed } of this.hostiles) {
      if (destroyed >= 0) add(destroyed, "attack", `Hostile at ${b.label(node)} destroyed`, node);
    }
    this.resolved.forEach((t, node) => {
      if (t >= 0 && !hostileAt.has(node)) add(t, "cleared", `${b.label(node)} is clear`, node);
    });
    b.rooms.forEach((node, i) => {
      for (let t = 1; t < F; t++) {
        if (this.unsearched[i * F + t] === 0 && this.unsearched[i * F + t - 1] > 0) add(t, "searched", `${b.label(node)} is searched`, node);
      }
    });
    const gather = (map, key, r) => (map.has(key) ? map.get(key).push(r) : map.set(key, [r]));
    for (let t = 1; t < F; t++) {
      const alerted = new Map(), lost = new Map(), repelled = new Map();
      for (let r = 0; r < R; r++) {
        if (!this.alive(r, t - 1)) continue;
        if (this.died[r] === t) gather(lost, this.place[r * F + t], r);
        else if (this.engaged[r * F + t]) gather(repelled, this.place[r * F + t - 1], r);
        if (this.danger[r * F + t] === 1 && this.danger[r * F + t - 1] === 0) gather(alerted, this.about[r * F + t], r);
      }
      for (const [node, who] of alerted) if (node >= 0) add(t, "alert", `${b.label(node)} suspected: ${robots(who)} alerted`, node, who);
      for (const [node, who] of lost) add(t, "loss", `${robots(who)} lost at ${b.label(node)}`, node, who);
      for (const [node, who] of repelled) add(t, "loss", `${robots(who)} would have been lost at ${b.label(node)}`, node, who);
      for (const members of this.teams[t - 1]) {
        const parts = new Set(members.map((r) => this.team[t * R + r]));
        parts.delete(-1);
        if (parts.size > 1) add(t, "split", `Team of ${members.length} splits into ${parts.size}`, -1, members);
      }
      for (const members of this.teams[t]) {
        const from = new Set(members.map((r) => this.team[(t - 1) * R + r]));
        if (from.size > 1) add(t, "merge", `${from.size} teams meet: ${members.length} robots`, -1, members);
      }
    }
    this.events = events.sort((p, q) => p.t - q.t);
  }
}

/** Probabilities of a draw by weight; a share `greedy` goes to the heaviest. All zero draws evenly. */
function chances(weights, greedy) {
  let sum = 0, most = -Infinity;
  for (const w of weights) { sum += w; most = Math.max(most, w); }
  const ties = weights.filter((w) => w === most).length;
  return Array.from(weights, (w) => (1 - greedy) * (sum > 0 ? w / sum : 1 / weights.length) + (w === most ? greedy / ties : 0));
}

/** Read a replay document from its text. */
async function readReplay(text) {
  let doc;
  try { doc = JSON.parse(text); } catch { throw new Unreadable("The replay is damaged or cut short: its data is not valid JSON."); }
  need(doc && doc.format === FORMAT, `This is no replay: expected the format ${FORMAT}.`);
  need(doc.version === VERSION, `This page reads replays of version ${VERSION}, found version ${String(doc.version)}; make it afresh with this release of tasklift.`);
  const building = new Building(doc.building);
  if (doc.building.plan) building.plan = await Floor.load(doc.building.plan);
  need(Array.isArray(doc.kinds) && Array.isArray(doc.tasks) && Array.isArray(doc.traces) && doc.traces.length > 0, "The replay holds no trace.");
  const kinds = doc.kinds.map((k) => {
    need(k && Number.isInteger(k.number) && k.number >= 0 && k.number < 1e6, "kinds: expected numbers of robots");
    return { name: String(k.name), armed: k.armed === true, number: k.number };
  });
  const tasks = [];
  for (const task of doc.tasks) {
    const variables = (list) => list.map((v) => ({ name: String(v.name), meaning: String(v.meaning), values: v.values.map(String), labels: v.labels.map(String) }));
    try {
      const inputs = variables(task.inputs), outputs = variables(task.outputs);
      const columns = await unpack(task.columns, "task, columns", task.columns.shape, 0, sizeOf(outputs) - 1);
      const signals = [];
      for (const s of task.signals) signals.push({ value: Number(s.value), name: String(s.name), where: new Set(await unpack(s.where, "task, signals", s.where.shape, 0, 1e9)) });
      tasks.push({ name: String(task.name), inputs, outputs, columns, signals });
    } catch (error) {
      throw error instanceof Unreadable ? error : new Unreadable("The replay's task is damaged.");
    }
  }
  const traces = [];
  for (const [i, trace] of doc.traces.entries()) traces.push(await Trace.load(trace, building, kinds, tasks, `trace ${i + 1}`));
  return { title: String(doc.title), madeBy: String(doc.made_by), building, kinds, traces };
}

// A session of an exported model: its tools, its periods in real time, recordings, and frames as those of the server.

import { IDENTITY, LocalTool, NO_TOOL, nearestOnAxis, overlap, roundShape } from "./localTool.js";
import { numbersOf, STATE_FIELDS, STATES } from "./protocol.js";

const PERIOD = 1; // [ms]
const TURN = 4; // [ms] between two turns of the loop
const MAX_DELAY = 50; // [ms] by which the body may be late before periods are dropped
const FRAME_INTERVAL = 1000 / 60; // [ms]
const RECORD_INTERVAL = 1000 / 30;
const MAX_RECORD_SECONDS = 120;
const STATISTICS_INTERVAL = 500;
const UNACKNOWLEDGED = 2; // state frames that wait for the page
const SAMPLES = 4000; // computing times that the statistics are of
const MAX_SPEED = 2; // in the options of a library (palpate.h)
const MARGIN = 0.3; // [m] around the body in which a tool may be
const DESCRIBED = ["kind", "active", "pinned", "radius", "length"]; // what a replay tells of a tool when it changes

export class LocalSession {
  /** `post` sends a message, or a frame (ArrayBuffer), to the page. */
  constructor(model, post) {
    Object.assign(this, { model, post, about: model.about, arrays: model.arrays });
    this.state = "running";
    this.speed = 1;
    this.modulus = 1;
    this.show = "displacement";
    this.tools = Array.from({ length: model.arrays.pose.length / 7 }, (_, index) => new LocalTool(model, index));
    this.groups = this.about.tools.length === 0; // the tool moves a group of nodes
    if (this.groups) {
      const group = { ...NO_TOOL, kind: "group" };
      Object.assign(this.tools[0], { selected: group, active: group, origin: this.about.group_centre });
    }
    this.follow(false);
    this.sent = this.acknowledged = 0;
    this.computing = new Float64Array(SAMPLES);
    this.periods = this.dropped = this.counted = 0;
    this.frames = null; // of the recording
    this.replay = null; // { frames, at, since, playing }
    this.last = this.drawn = this.recorded = this.told = performance.now();
    this.begin();
    this.turn();
  }

  /** Say hello, and send the surface. */
  begin() {
    const { about } = this;
    const replay = this.replay && { mode: "replay", duration: this.duration(), tools: [], materials: [], tool_speed: null };
    this.post({
      type: "hello", protocol: 3, driver: true, viewers: 1, mode: "live", ...about, max_tools: this.tools.length, ...this.describe(),
      materials: this.materials(), overlay: false, full: false, returns: true, ...replay,
    });
    const { vertices, triangles, fixed, rest } = this.arrays;
    const count = vertices.length / 3;
    const buffer = new ArrayBuffer(16 + 12 * count + 4 * triangles.length + count);
    new Uint32Array(buffer, 0, 4).set([1, 0, count, triangles.length / 3]);
    new Float32Array(buffer, 16, 3 * count).set(rest);
    new Uint32Array(buffer, 16 + 12 * count, triangles.length).set(triangles);
    new Uint8Array(buffer, 16 + 12 * count + 4 * triangles.length, count).set(fixed);
    this.post(buffer);
    this.acknowledged = this.sent;
    this.dirty = true;
    this.sendStatus();
  }

  materials() {
    return this.about.materials.map((material) => ({ ...material, value: this.modulus * material.value }));
  }

  /** The tools by index, of the session or of the replay; and the first one. */
  describe() {
    const { replay } = this;
    const described = replay ? replay.frames[Math.max(replay.shown, 0)].described : this.tools.map((tool) => tool.describe());
    return { tool: described[0], all_tools: described };
  }

  sendStatus() {
    const state = this.replay ? (this.replay.playing ? "running" : "paused") : this.state;
    this.post({
      type: "status", driver: true, viewers: 1, state, speed: this.speed, fast: this.fast, ...this.describe(), pause_reason: null,
      recording: this.frames !== null, ...(this.replay ? {} : { materials: this.materials() }),
    });
  }

  // the loop

  turn() {
    setTimeout(() => this.turn(), TURN);
    const now = performance.now();
    if (this.replay) this.playOn(now);
    else this.stepTo(now);
    if (now - this.told > STATISTICS_INTERVAL) this.sendStatistics(now);
  }

  /** Take the periods up to now; drop those by which the body is too late. */
  stepTo(now) {
    if (this.state !== "running") this.last = now;
    const period = PERIOD / this.speed;
    if (now - this.last > MAX_DELAY) {
      const late = Math.floor((now - this.last - MAX_DELAY) / period);
      this.dropped += Math.max(late, 0);
      this.last = now - MAX_DELAY;
    }
    const began = performance.now();
    let [count, status] = [0, 0];
    while (now - this.last >= period && status !== 2 && performance.now() - began < FRAME_INTERVAL) {
      for (const tool of this.tools) tool.follow();
      status = this.model.call("step");
      this.last += period;
      count++;
    }
    // the clocks of browsers are too coarse for one period
    for (let k = 0; k < count; k++) this.computing[this.periods++ % SAMPLES] = (performance.now() - began) / count;
    this.dirty ||= count > 0;
    if (status === 2) {
      this.state = "diverged";
      this.sendStatus();
    }
    if (this.frames && now - this.recorded > RECORD_INTERVAL) this.record(now);
    if (this.dirty && now - this.drawn >= FRAME_INTERVAL && this.sent - this.acknowledged < UNACKNOWLEDGED) {
      this.drawn = now;
      this.dirty = false;
      this.send(this.shot());
    }
  }

  /** Send frames of tools and state, whose sequence number is the next one. */
  send(frames) {
    this.sent++;
    for (const buffer of frames) {
      new Uint32Array(buffer, 4, 1)[0] = this.sent;
      this.post(buffer);
    }
  }

  /** The frames of the present state, of all tools and of the body. */
  shot() {
    return [this.toolFrame(), this.stateFrame()];
  }

  /** docs/reference/protocol.md, kind 8. */
  toolFrame() {
    const numbers = this.tools.flatMap((tool) => tool.numbers());
    const buffer = new ArrayBuffer(16 + 8 * numbers.length);
    new Uint32Array(buffer, 0, 4).set([8, 0, this.tools.length, 0]);
    new Float64Array(buffer, 16).set(numbers);
    return buffer;
  }

  /** docs/reference/protocol.md, kind 2. */
  stateFrame() {
    const { record, vertices, rest } = this.arrays;
    const at = this.about.record;
    const [tool] = this.tools;
    const count = vertices.length / 3;
    this.model.call("vertices");
    const shown = this.show === "displacement";
    const names = ["time", "trust", "kinetic", "strain", "steps"];
    const period = Object.fromEntries(names.map((name) => [name, record[at[name]]]));
    const computing = this.periods ? this.computing[(this.periods - 1) % SAMPLES] / 1e3 : 0;
    const scalar = new Float32Array(shown ? count : 0);
    for (let i = 0; i < scalar.length; i++) {
      scalar[i] = Math.hypot(vertices[3 * i] - rest[3 * i], vertices[3 * i + 1] - rest[3 * i + 1], vertices[3 * i + 2] - rest[3 * i + 2]);
    }
    const high = scalar.slice().sort()[Math.min(count - 1, Math.round(0.99 * (count - 1)))]; // peaks of single vertices
    const numbers = numbersOf(STATE_FIELDS, { ...tool.values(), ...period, computing, state: STATES.indexOf(this.state), high });
    const start = 16 + 8 * numbers.length;
    const buffer = new ArrayBuffer(start + 12 * count + 4 * scalar.length);
    new Uint32Array(buffer, 0, 4).set([2, 0, count, 0]);
    new Float64Array(buffer, 16, numbers.length).set(numbers);
    new Float32Array(buffer, start, 3 * count).set(vertices);
    new Float32Array(buffer, start + 12 * count).set(scalar);
    return buffer;
  }

  sendStatistics(now) {
    const sorted = this.computing.slice(0, Math.min(this.periods, SAMPLES)).sort();
    const at = (share) => (sorted.length ? sorted[Math.round(share * (sorted.length - 1))] : 0);
    const [periods, lost] = [this.periods - this.counted, this.dropped];
    const bound = Math.max(...this.arrays.force_bound);
    this.post({
      type: "statistics", median_ms: at(0.5), p99_ms: at(0.99), misses: 0, periods: Math.max(this.periods, 1),
      pace: periods + lost > 0 ? periods / (periods + lost) : 1, force_bound: Number.isFinite(bound) ? bound : null,
    });
    Object.assign(this, { told: now, counted: this.periods, dropped: 0 });
  }

  // messages of the page

  handle(message) {
    const act = {
      ack: ({ sequence }) => (this.acknowledged = Math.max(this.acknowledged, sequence)),
      show: ({ scalar }) => Object.assign(this, { show: scalar, dirty: true }),
      pose: (pose) => this.move(pose),
      tool: (tool) => this.select(tool),
      pin: (pin) => this.pin(pin),
      release: ({ index = 0 }) => this.release(index),
      control: ({ action }) => this.control(action),
      speed: ({ factor }) => Object.assign(this, { speed: factor, last: performance.now() }),
      follow: ({ fast }) => this.follow(fast),
      material: ({ value }) => this.setModulus(value),
      record: ({ action }) => (action === "start" ? this.startRecording() : this.stopRecording()),
      replay: ({ action, time }) => this.control(action, time),
    }[message.type];
    const count = this.tools.length;
    const late = this.replay && ["pose", "tool", "pin"].includes(message.type); // a replay takes no tool
    if ((message.index ?? 0) < count) late || act?.(message);
    else this.refuse(`This model takes ${count} tool${count > 1 ? "s" : ""} at most.`);
    if (!["ack", "pose"].includes(message.type)) this.sendStatus();
  }

  inside(position) {
    const [low, high] = this.about.bounds;
    return position.map((part, k) => Math.min(Math.max(part, low[k] - MARGIN), high[k] + MARGIN));
  }

  move({ index = 0, position, quaternion = IDENTITY, sequence = 0 }) {
    const tool = this.tools[index];
    if (tool.pinned) return this.refuse("The tool is held where it is; take it in hand first.");
    const place = this.inside(position);
    if (tool.active.kind === "none" && !this.putBack(tool, place, quaternion)) return;
    tool.request(place, quaternion, sequence);
  }

  /** Put the selected tool down again where it is clear of body and tools; forceps do not come back. */
  putBack(tool, position, quaternion) {
    const { selected } = tool;
    if ((selected.kind !== "sphere" && selected.kind !== "capsule") || this.blocked(tool, selected, position, quaternion)) return false;
    return this.put(tool, selected, position, quaternion);
  }

  pin({ index = 0, pinned }) {
    const tool = this.tools[index];
    if (tool.active.kind === "none") return this.refuse("Only a tool that is put down can be held; put it down first.");
    tool.pinned = pinned;
  }

  /** Why a tool cannot be in a place, or null. */
  blocked(tool, shape, position, quaternion) {
    const round = roundShape(shape, position, quaternion);
    if (shape.kind !== "grasp" && !this.isOutside(round)) return "The tool must be outside the body; put it down outside.";
    const clear = this.tools.every((other) => other === tool || other.active.kind === "none" || !overlap(round, other.shape));
    return clear ? null : "The tool must be clear of the other tools; put it down elsewhere.";
  }

  select(message) {
    const { kind, radius = 0.015, length = 0.04, friction = 0.2, stiffness = null, quaternion = IDENTITY } = message;
    if (!this.about.tools.includes(kind)) return this.refuse(`This body takes no tool of kind ${kind}.`);
    let position = this.inside(message.position);
    const slot = this.tools[message.index ?? 0];
    const tool = { kind, radius, length, friction, stiffness };
    if (kind === "grasp") {
      const vertex = this.nearest(position);
      if (vertex.distance > Math.max(radius, 2 * this.about.spacing)) return this.refuse("Forceps must be at the surface; choose a point on it.");
      if (this.holdsSupport(vertex.number, radius)) return this.refuse("Forceps must be away from the support; choose another place.");
      this.arrays.tool_point.set(this.arrays.rest.subarray(3 * vertex.number, 3 * vertex.number + 3));
      position = Array.from(this.arrays.vertices.subarray(3 * vertex.number, 3 * vertex.number + 3));
    }
    const why = this.blocked(slot, tool, position, quaternion);
    if (why) return this.refuse(why);
    if (!this.put(slot, tool, position, quaternion)) return;
    Object.assign(slot, { selected: tool, sequence: message.sequence ?? 0 });
  }

  refuse(reason) {
    this.post({ type: "error", reason });
  }

  /** Replace a tool; returns whether the model takes it. */
  put(slot, tool, position, quaternion) {
    const taken = slot.put(this.model, tool, position, quaternion);
    if (!taken) this.refuse(tool.kind === "grasp" ? "Other forceps hold the tissue here; choose another place." : "The tool is out of range.");
    this.dirty = true;
    return taken;
  }

  /** Put a tool away; a group of nodes returns to its place at rest. */
  release(index) {
    const tool = this.tools[index];
    tool.pinned = false;
    if (this.groups) tool.home();
    else if (tool.active.kind !== "none") this.put(tool, { ...tool.selected, kind: "none" }, tool.position, tool.quaternion);
  }

  nearest(position) {
    const { vertices } = this.arrays;
    this.model.call("vertices");
    let [number, distance] = [0, Infinity];
    for (let i = 0; i < vertices.length / 3; i++) {
      const far = Math.hypot(vertices[3 * i] - position[0], vertices[3 * i + 1] - position[1], vertices[3 * i + 2] - position[2]);
      if (far < distance) [number, distance] = [i, far];
    }
    return { number, distance };
  }

  holdsSupport(vertex, radius) {
    const { rest, fixed } = this.arrays;
    return fixed.some((held, i) => held && Math.hypot(...[0, 1, 2].map((k) => rest[3 * i + k] - rest[3 * vertex + k])) <= radius);
  }

  /** Whether a round shape is outside: its nearest vertex is, and faces it. */
  isOutside(round) {
    const { vertices, triangles } = this.arrays;
    this.model.call("vertices");
    let [number, gap, near] = [0, Infinity, round.position];
    for (let i = 0; i < vertices.length / 3; i++) {
      const found = nearestOnAxis(round, Array.from(vertices.subarray(3 * i, 3 * i + 3)));
      if (found.distance - round.radius < gap) [number, gap, near] = [i, found.distance - round.radius, found.near];
    }
    if (gap < -0.25 * this.about.spacing) return false;
    const normal = [0, 0, 0];
    const at = (corner, k) => vertices[3 * corner + k];
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b, c] = triangles.subarray(t, t + 3);
      if (a !== number && b !== number && c !== number) continue;
      const [u, v] = [b, c].map((corner) => [0, 1, 2].map((k) => at(corner, k) - at(a, k)));
      for (let k = 0; k < 3; k++) normal[k] += u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3];
    }
    return normal.reduce((sum, part, k) => sum + part * (near[k] - at(number, k)), 0) > 0;
  }

  /** Let tools follow as fast as they move at most, or no faster than the training went. */
  follow(fast) {
    const { tool_speed: trained, max_tool_speed: most } = this.about;
    this.fast = fast && trained !== null;
    this.arrays.options[MAX_SPEED] = this.fast ? most : trained ?? most;
  }

  setModulus(value) {
    const [{ value: own, low, high }] = this.about.materials;
    if (!(value >= low && value <= high)) return this.refuse(`The modulus must be from ${low} to ${high} kPa.`);
    this.modulus = value / own;
    this.arrays.modulus_ratio[1] = this.modulus;
  }

  control(action, time) {
    const { replay } = this;
    const now = performance.now();
    if (replay) {
      if (action === "live") return this.endReplay();
      if (action === "seek" || action === "reset") Object.assign(replay, { at: Math.min(time ?? 0, this.duration()), since: now, shown: -1 });
      if (action === "play" || action === "resume") {
        const over = replay.at >= this.duration();
        Object.assign(replay, { at: over ? 0 : replay.at, since: now, playing: true });
      }
      if (action === "pause") Object.assign(replay, { playing: false });
      return;
    }
    if (action === "reset") {
      this.model.call("reset");
      for (const { index } of this.tools) this.release(index);
      if (this.state === "diverged") this.state = "running";
    }
    if (action === "pause") this.state = "paused";
    if (action === "resume" && this.state === "paused") this.state = "running";
    Object.assign(this, { last: now, dirty: true });
  }

  // recordings

  startRecording() {
    this.frames = [];
    this.began = this.recorded = performance.now();
  }

  record(now) {
    this.recorded = now;
    this.frames.push({ time: (now - this.began) / 1000, data: this.shot(), described: this.tools.map((tool) => tool.describe()) });
    if (now - this.began > 1000 * MAX_RECORD_SECONDS) {
      this.stopRecording();
      this.sendStatus();
    }
  }

  /** Show the recording. */
  stopRecording() {
    const { frames } = this;
    this.frames = null;
    if (!frames?.length) return this.refuse("The recording is empty.");
    for (const { index } of this.tools) this.release(index);
    this.replay = { frames, at: 0, since: performance.now(), playing: true, shown: -1 };
    this.begin();
  }

  endReplay() {
    this.replay = null;
    this.last = performance.now();
    this.begin();
  }

  duration() {
    return this.replay.frames.at(-1).time;
  }

  playOn(now) {
    const { replay } = this;
    if (replay.playing) replay.at += (this.speed * (now - replay.since)) / 1000;
    replay.since = now;
    if (replay.at >= this.duration() && replay.playing) {
      Object.assign(replay, { at: this.duration(), playing: false });
      this.sendStatus();
    }
    const number = Math.max(0, replay.frames.findLastIndex(({ time }) => time <= replay.at));
    if (number === replay.shown || this.sent - this.acknowledged >= UNACKNOWLEDGED) return;
    const { data, time, described } = replay.frames[number];
    const changed = JSON.stringify(described, DESCRIBED) !== JSON.stringify(this.describe().all_tools, DESCRIBED);
    replay.shown = number;
    if (changed) this.sendStatus();
    const buffers = data.map((buffer) => buffer.slice(0));
    new Float64Array(buffers[1], 16, 1)[0] = time;
    this.send(buffers);
  }
}

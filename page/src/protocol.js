// The protocol: binary frames from the server, and JSON messages in both directions.

export const STATES = ["stopped", "running", "paused", "diverged"];
export const TOOLS = ["none", "sphere", "capsule", "grasp", "group", "scalpel"]; // of hello, where it has more

const HEADER_BYTES = 16; // kind, sequence, vertices, triangles

// Fields of float64 values and their numbers, in order; a test compares them with those of the server.
export const STATE_FIELDS = {
  time: 1, trust: 1, force: 3, moment: 3, position: 3, quaternion: 4, kinetic: 1, strain: 1, computing: 1, lateness: 1,
  steps: 1, state: 1, kind: 1, low: 1, high: 1, sequence: 1,
};
export const TOOL_FIELDS = { kind: 1, pinned: 1, force: 3, moment: 3, position: 3, quaternion: 4, sequence: 1 };

const count = (fields) => Object.values(fields).reduce((sum, size) => sum + size, 0);
const STATE_NUMBERS = count(STATE_FIELDS);
const TOOL_NUMBERS = count(TOOL_FIELDS);

/** The values of fields from an index of a buffer on; several numbers are a view of it. */
function read(buffer, start, fields) {
  const numbers = new Float64Array(buffer, start, count(fields));
  let at = 0;
  const entries = Object.entries(fields).map(([name, size]) => {
    at += size;
    return [name, size > 1 ? numbers.subarray(at - size, at) : numbers[at - 1]];
  });
  return Object.fromEntries(entries);
}

/** The float64 values of fields as a list; those that are not given are 0. */
export function numbersOf(fields, values) {
  return Object.entries(fields).flatMap(([name, size]) => (size > 1 ? [...values[name]] : values[name] ?? 0));
}

/** Decode a binary frame; arrays are views of the buffer. */
export function decode(buffer) {
  const [kind, sequence, vertices, triangles] = new Uint32Array(buffer, 0, 4);
  if (kind === 1 || kind === 5 || kind === 6) {
    const positions = new Float32Array(buffer, HEADER_BYTES, 3 * vertices);
    const start = HEADER_BYTES + 12 * vertices;
    const fixed = new Uint8Array(buffer, start + 12 * triangles, vertices);
    const line = kind === 6 ? cutLine(buffer, 4 * Math.ceil((start + 12 * triangles + vertices) / 4), sequence) : null;
    return { kind, sequence, positions, triangles: new Uint32Array(buffer, start, 3 * triangles), fixed, line };
  }
  if (kind === 7) return surroundings(buffer, sequence, vertices, triangles);
  if (kind === 2) return state(buffer, sequence, vertices);
  if (kind === 8) return { kind, sequence, tools: Array.from({ length: vertices }, (_, index) => tool(buffer, index)) };
  if (kind === 3) {
    const force = new Float32Array(buffer, HEADER_BYTES + 12 * vertices, 3);
    return { kind, sequence, positions: new Float32Array(buffer, HEADER_BYTES, 3 * vertices), newtons: Math.hypot(...force) };
  }
  return { kind, sequence };
}

/** The line along which a cut opens a surface, of `count` pieces: corners of their triangles, and their ends there. */
function cutLine(buffer, start, count) {
  return { corners: new Uint32Array(buffer, start, 3 * count), ends: new Float32Array(buffer, start + 12 * count, 4 * count) };
}

/** Shapes around a body, `count` of them, with names and kinds, and the edges of its image: planes of a point and a normal. */
function surroundings(buffer, count, vertices, triangles) {
  const start = HEADER_BYTES + 12 * vertices;
  const sizes = start + 12 * triangles;
  return {
    kind: 7,
    positions: new Float32Array(buffer, HEADER_BYTES, 3 * vertices),
    triangles: new Uint32Array(buffer, start, 3 * triangles),
    sizes: new Uint32Array(buffer, sizes, count),
    ...JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, sizes + 4 * count))),
  };
}

function state(buffer, sequence, vertices) {
  const values = read(buffer, HEADER_BYTES, STATE_FIELDS);
  const start = HEADER_BYTES + 8 * STATE_NUMBERS;
  const end = start + 12 * vertices;
  return {
    ...values,
    kind: 2,
    sequence,
    newtons: Math.hypot(...values.force),
    state: STATES[values.state] ?? "stopped",
    tool: TOOLS[values.kind] ?? "none",
    pose: values.sequence,
    positions: new Float32Array(buffer, start, 3 * vertices),
    scalar: buffer.byteLength > end ? new Float32Array(buffer, end, vertices) : null,
  };
}

/** The tool of an index in a frame of all tools. */
function tool(buffer, index) {
  const { kind, pinned, sequence, ...values } = read(buffer, HEADER_BYTES + 8 * TOOL_NUMBERS * index, TOOL_FIELDS);
  return { ...values, kind: TOOLS[kind] ?? "none", pinned: pinned === 1, newtons: Math.hypot(...values.force), pose: sequence };
}

const VERSIONS = { "palpate.v3": 3, "palpate.v2": 2 }; // by subprotocol, the newest first
const FIRST_RETRY_DELAY = 500; // [ms], doubled after each failure
const MAX_RETRY_DELAY = 8000;
const FINAL_CODES = { 4401: "token", 4400: "refused", 4429: "full" }; // closing codes without a retry

/** The address of the session's socket: next to the page, also below a prefix, and secure where the page is. */
export function socketAddress(page) {
  const address = new URL("session", page);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  return address.href;
}

/** A connection that reconnects. Calls on.message, on.frame, on.lost(seconds, opened) and on.ended(reason). */
export class Connection {
  constructor(url, token, on) {
    Object.assign(this, { url, token, on, wait: FIRST_RETRY_DELAY, timer: 0, opened: false });
    this.connect();
  }

  connect() {
    clearTimeout(this.timer);
    const socket = new WebSocket(this.url, Object.keys(VERSIONS));
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.opened = true;
      this.send({ type: "hello", protocol: VERSIONS[socket.protocol], token: this.token, preparation: true, surroundings: true });
    };
    socket.onmessage = ({ data }) => {
      if (socket !== this.socket) return;
      if (typeof data !== "string") return this.on.frame(decode(data));
      const message = JSON.parse(data);
      if (message.tool_kinds) TOOLS.splice(0, TOOLS.length, ...message.tool_kinds);
      if (["hello", "preparing", "labels"].includes(message.type)) this.wait = FIRST_RETRY_DELAY;
      this.on.message(message);
    };
    socket.onclose = ({ code }) => {
      if (socket !== this.socket) return;
      if (FINAL_CODES[code]) return this.on.ended(FINAL_CODES[code]);
      this.on.lost(this.wait / 1000, this.opened);
      this.timer = setTimeout(() => this.connect(), this.wait);
      this.wait = Math.min(2 * this.wait, MAX_RETRY_DELAY);
    };
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** Close for good. */
  close() {
    this.closed = true;
    clearTimeout(this.timer);
    this.socket.onclose = null;
    this.socket.close();
  }

  /** Reconnect at once. */
  reconnect() {
    if (!this.closed && this.socket.readyState === WebSocket.CLOSED) this.connect();
  }
}

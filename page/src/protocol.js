// The protocol: binary frames from the server, and JSON messages in both directions.

export const STATES = ["stopped", "running", "paused", "diverged"];
export const TOOLS = ["none", "sphere", "capsule", "grasp", "group", "scalpel"]; // of hello, where it has more

const HEADER_BYTES = 16; // kind, sequence, vertices, triangles
const STATE_NUMBERS = 25; // float64 values of a state
const TOOL_NUMBERS = 16; // of a tool
const [KIND, PINNED, FORCE, MOMENT, POSITION, QUATERNION, SEQUENCE] = [0, 1, 2, 5, 8, 11, 15]; // where they are

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

/** Shapes around a body; `count` of them. */
function surroundings(buffer, count, vertices, triangles) {
  const start = HEADER_BYTES + 12 * vertices;
  const sizes = start + 12 * triangles;
  return {
    kind: 7,
    positions: new Float32Array(buffer, HEADER_BYTES, 3 * vertices),
    triangles: new Uint32Array(buffer, start, 3 * triangles),
    sizes: new Uint32Array(buffer, sizes, count),
    names: JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, sizes + 4 * count))),
  };
}

function state(buffer, sequence, vertices) {
  const numbers = new Float64Array(buffer, HEADER_BYTES, STATE_NUMBERS);
  const start = HEADER_BYTES + 8 * STATE_NUMBERS;
  const end = start + 12 * vertices;
  const force = numbers.subarray(2, 5);
  return {
    kind: 2,
    sequence,
    time: numbers[0],
    trust: numbers[1],
    force,
    newtons: Math.hypot(...force),
    position: numbers.subarray(8, 11),
    quaternion: numbers.subarray(11, 15),
    kinetic: numbers[15],
    strain: numbers[16],
    computing: numbers[17],
    lateness: numbers[18],
    steps: numbers[19],
    state: STATES[numbers[20]] ?? "stopped",
    tool: TOOLS[numbers[21]] ?? "none",
    low: numbers[22],
    high: numbers[23],
    pose: numbers[24],
    positions: new Float32Array(buffer, start, 3 * vertices),
    scalar: buffer.byteLength > end ? new Float32Array(buffer, end, vertices) : null,
  };
}

/** The tool of an index in a frame of all tools. */
function tool(buffer, index) {
  const numbers = new Float64Array(buffer, HEADER_BYTES + 8 * TOOL_NUMBERS * index, TOOL_NUMBERS);
  const force = numbers.subarray(FORCE, MOMENT);
  return {
    kind: TOOLS[numbers[KIND]] ?? "none",
    pinned: numbers[PINNED] === 1,
    force,
    newtons: Math.hypot(...force),
    position: numbers.subarray(POSITION, QUATERNION),
    quaternion: numbers.subarray(QUATERNION, SEQUENCE),
    pose: numbers[SEQUENCE],
  };
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

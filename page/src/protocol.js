// What goes over the wire: binary frames from the server, JSON both ways.

export const STATES = ["stopped", "running", "paused", "ran away"];
export const TOOLS = ["none", "sphere", "capsule", "grasp", "group"];

const HEADER = 16; // bytes: kind, sequence, vertices, triangles
const NUMBERS = 25; // float64 of a state

/** Read a binary frame. Arrays are views of the buffer: nothing is copied. */
export function decode(buffer) {
  const [kind, sequence, vertices, triangles] = new Uint32Array(buffer, 0, 4);
  if (kind === 1) {
    const positions = new Float32Array(buffer, HEADER, 3 * vertices);
    return { kind, sequence, positions, triangles: new Uint32Array(buffer, HEADER + 12 * vertices, 3 * triangles) };
  }
  if (kind === 2) return state(buffer, sequence, vertices);
  if (kind === 3) return { kind, sequence, positions: new Float32Array(buffer, HEADER, 3 * vertices) };
  return { kind, sequence };
}

function state(buffer, sequence, vertices) {
  const numbers = new Float64Array(buffer, HEADER, NUMBERS);
  const start = HEADER + 8 * NUMBERS;
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

const FIRST_WAIT = 500; // [ms], doubled each time
const LONGEST_WAIT = 8000;
const FOR_GOOD = { 4401: "token", 4400: "refused", 4429: "full" }; // closings after which trying again is of no use

/** A connection that comes back by itself. Calls on.message, on.frame, on.open, on.lost(seconds) and on.ended(why). */
export class Connection {
  constructor(url, token, on) {
    Object.assign(this, { url, token, on, wait: FIRST_WAIT, timer: 0 });
    this.connect();
  }

  connect() {
    clearTimeout(this.timer);
    const socket = new WebSocket(this.url, "palpate.v1");
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.send({ type: "hello", protocol: 1, token: this.token });
    socket.onmessage = ({ data }) => {
      if (socket !== this.socket) return;
      if (typeof data !== "string") return this.on.frame(decode(data));
      const message = JSON.parse(data);
      if (message.type === "hello") this.wait = FIRST_WAIT;
      this.on.message(message);
    };
    socket.onclose = ({ code }) => {
      if (socket !== this.socket) return;
      if (FOR_GOOD[code]) return this.on.ended(FOR_GOOD[code]);
      this.on.lost(this.wait / 1000);
      this.timer = setTimeout(() => this.connect(), this.wait);
      this.wait = Math.min(2 * this.wait, LONGEST_WAIT);
    };
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** Try at once instead of waiting. */
  hurry() {
    if (this.socket.readyState === WebSocket.CLOSED) this.connect();
  }
}

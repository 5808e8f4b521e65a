// A tool of an exported model: what is selected, where it was put down, and its rows of the model's arrays.

import { numbersOf, TOOL_FIELDS, TOOLS } from "./protocol.js";

const HAND_FORCE = 3.3; // [N], largest force of the spring between pointer and tool
const TOOL_MASS = 0.05; // [kg]
const KINDS = { none: -1n, sphere: 0n, capsule: 0n, grasp: 3n };
const DRAWN_FORCEPS = 0.3; // radius of the ball as which forceps are drawn, over that within which they hold nodes
const AXIS_POINTS = 65; // of a capsule

export const IDENTITY = [1, 0, 0, 0];
export const NO_TOOL = { kind: "none", radius: 0, length: 0, friction: 0, stiffness: null };

/** The product of quaternions: the rotation b, then a. */
function multiply([a, b, c, d], [w, x, y, z]) {
  return [a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w];
}
const inverse = ([w, x, y, z]) => [w, -x, -y, -z];

/** A ball or a capsule as the points within `radius` of an axis; forceps are the ball as which they are drawn. */
export function roundShape({ kind, radius, length }, position, [w, x, y, z]) {
  const axis = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)];
  return { position, axis, half: kind === "capsule" ? length / 2 : 0, radius: kind === "grasp" ? DRAWN_FORCEPS * radius : radius };
}

/** The point of the axis of a round shape that is nearest to a point, and the distance of the two. */
export function nearestOnAxis({ position, axis, half }, point) {
  const away = point.map((part, k) => part - position[k]);
  const along = Math.min(Math.max(away[0] * axis[0] + away[1] * axis[1] + away[2] * axis[2], -half), half);
  return { near: position.map((part, k) => part + along * axis[k]), distance: Math.hypot(...away.map((part, k) => part - along * axis[k])) };
}

/** Whether two round shapes have points in common. */
export function overlap(first, second) {
  const { position, axis, half } = first;
  const count = half > 0 ? AXIS_POINTS : 1;
  for (let i = 0; i < count; i++) {
    const along = count > 1 ? half * ((2 * i) / (count - 1) - 1) : 0;
    const { distance } = nearestOnAxis(second, position.map((part, k) => part + along * axis[k]));
    if (distance < first.radius + second.radius) return true;
  }
  return false;
}

const LONGEST_WAY = 40; // [periods] in which a tool reaches a new pose, at most

export class LocalTool {
  constructor({ about, arrays }, index) {
    const { start, size } = about.tool_record;
    const row = (array, columns, first = 0) => array.subarray(first + columns * index, first + columns * (index + 1));
    Object.assign(this, { index, fields: about.tool_record, selected: NO_TOOL, active: NO_TOOL, pinned: false, sequence: 0 });
    Object.assign(this, { origin: [0, 0, 0], rotation: IDENTITY, record: row(arrays.record, size, start) });
    Object.assign(this, { left: 0, since: 0, pose: row(arrays.pose, 7), coupling: row(arrays.coupling, 4), moved: row(arrays.tool_position, 3) });
  }

  get position() {
    return this.origin.map((part, k) => part + this.moved[k]);
  }

  get quaternion() {
    return multiply(this.part("quaternion", 4), this.rotation);
  }

  get shape() {
    return roundShape(this.active, this.position, this.quaternion);
  }

  /** Numbers of the tool in the record of the last period. */
  part(name, count) {
    return Array.from(this.record.subarray(this.fields[name], this.fields[name] + count));
  }

  describe() {
    const { selected, position, quaternion, pinned } = this;
    return { ...selected, active: this.active === selected && selected.kind !== "none", position, quaternion, pinned };
  }

  /** The values of a tool in a frame, by name. */
  values() {
    const { active, pinned, position, quaternion, sequence } = this;
    const [force, moment] = [this.part("force", 3), this.part("moment", 3)];
    return { kind: TOOLS.indexOf(active.kind), pinned: Number(pinned), force, moment, position, quaternion, sequence };
  }

  /** The numbers of a frame of all tools; docs/reference/protocol.md, kind 8. */
  numbers() {
    return numbersOf(TOOL_FIELDS, this.values());
  }

  /** Request a pose, which the tool reaches evenly in the time since the one before: a pointer sends one a frame. */
  request(position, quaternion, sequence) {
    const goal = [...position.map((part, k) => part - this.origin[k]), ...multiply(quaternion, inverse(this.rotation))];
    const turned = goal.slice(3).reduce((sum, part, k) => sum + part * this.pose[3 + k], 0) < 0; // the same rotation
    this.goal = goal.map((part, k) => (k > 2 && turned ? -part : part));
    Object.assign(this, { sequence, left: Math.min(Math.max(this.since, 1), LONGEST_WAY), since: 0 });
  }

  /** Move the requested pose on by a period; the model makes the length of the quaternion 1. */
  follow() {
    this.since += 1;
    if (!(this.left > 0)) return;
    this.goal.forEach((part, k) => (this.pose[k] += (part - this.pose[k]) / this.left));
    this.left -= 1;
  }

  /** Let the pose be that in which the tool was put down. */
  home() {
    this.pose.set([0, 0, 0, ...IDENTITY]);
    Object.assign(this, { left: 0, since: 0 });
  }

  /** Put a tool in place of this one; forceps hold the nodes near the point in `arrays.tool_point`. Returns whether it is in range. */
  put(model, tool, position, quaternion) {
    const { arrays } = model;
    const turned = tool.kind === "grasp" ? IDENTITY : quaternion; // forceps turn nodes as much as they are turned
    arrays.tool_index[0] = BigInt(this.index);
    arrays.tool_kind[0] = KINDS[tool.kind];
    arrays.tool_sizes.set([tool.radius, tool.kind === "capsule" ? tool.length / 2 : 0, 0]);
    arrays.tool_friction[0] = tool.friction;
    arrays.tool_pose.set([...position, ...turned]);
    if (model.call("set_tool") !== 0) return false;
    const k = tool.stiffness ?? 0;
    this.coupling.set(k > 0 ? [k, 2 * Math.sqrt(k * TOOL_MASS), TOOL_MASS, HAND_FORCE] : [0, 0, 0, Infinity]);
    Object.assign(this, { active: tool, origin: position, rotation: quaternion, pinned: false });
    this.home();
    return true;
  }
}

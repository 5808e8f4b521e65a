// One press, from contact to release: the pose of the tool, and the messages to the server.
import * as three from "three";
import { deepestStroke } from "./bladeEdge.js";
import { depthAt, Growth } from "./pressDepth.js";

const APPROACH_GAP = 0.008; // [m] between surface and tool at the start, so that the tool is outside the body
const APPROACH_TIME = 0.07; // [s], time constant
const FOLLOW_TIME = 0.04; // [s] in which the session moves a tool to a pose, at most
const TOUCH_GAP = 3e-4; // [m] left of the approach at which a press begins to grow
const TOUCH_FORCE = 2e-3; // [N] of a tool that has touched
const SHORT_TIME = 0.5; // [s] in which a short click touches, at most
const DEPTH_SHARE = 0.35; // depth of a click that is held, over the radius of the ball
const CLICK_SHARE = 0.02; // the same over the diagonal of the body, at most
const RETRY_TIME = 0.3; // [s] without an active tool before a retry from farther away
const TURN_WAY = 0.3; // lengths of a blade in which it turns into its stroke
const REVERSE_WAY = 0.1; // lengths of a blade that it goes back before its arrow turns
const MIN_SLOPE = 0.3; // cosine between view and normal below which a stroke no longer follows the pointer
const STROKE_REACH = 0.7; // of a blade around its body, in lengths of it

let sequence = 0;

/** Unit vector of a direction along a surface. */
const flatten = (direction, normal) => direction.addScaledVector(normal, -direction.dot(normal)).normalize();

/** Quaternion w, x, y, z of a tool: z outwards and x along the surface, or for a capsule x outwards and z along it. */
function turned(kind, normal, along) {
  const third = new three.Vector3().crossVectors(normal, along);
  const basis = new three.Matrix4();
  if (kind === "capsule") basis.makeBasis(normal, third.negate(), along);
  else basis.makeBasis(along, third, normal);
  const { w, x, y, z } = new three.Quaternion().setFromRotationMatrix(basis);
  return [w, x, y, z];
}

export class Press {
  /** `roll` [rad] is the turn of the tool around the normal of the surface. */
  constructor(scene, page, hit, stamp, { tool, index = 0, roll = 0 }) {
    Object.assign(this, { scene, page, hit, stamp, tool, index, lastKey: "", timeWithoutTool: 0, age: 0, touched: false, leaving: false });
    this.grasps = tool.kind === "grasp" || tool.kind === "group";
    this.cuts = tool.kind === "scalpel";
    this.offset = new three.Vector3(); // along the surface; for forceps in any direction
    this.turn = 0; // [rad] around the normal, of a prescribed group
    this.normal = hit.normal.clone();
    this.growth = this.grasps || this.cuts ? null : new Growth(Math.min(DEPTH_SHARE * tool.radius, CLICK_SHARE * scene.size));
    this.depth = this.growth?.light ?? (this.cuts ? tool.depth : 0);
    this.first = sequence + 1; // of its poses
    this.begin();
    if (this.cuts) this.depth = Math.min(this.depth, this.deepest);
    this.approach = this.grasps ? 0 : this.depth + APPROACH_GAP;
    this.least = this.grasps ? -Infinity : 0; // [m] of the depth
    const { position, along } = Press.initialPose(scene, tool, hit, roll);
    this.along = along; // of the tool, on the surface
    this.way = 1; // in which a blade goes, along it
    this.trail = 0;
    this.home = tool.kind === "group" ? new three.Vector3(...tool.position) : position;
    if (this.cuts) this.bias = scene.body.atRest.around(hit.point.toArray(), this.normal.toArray(), tool.length).height;
    if (tool.kind === "grasp") {
      sequence += 1;
      page.send({ ...tool, type: "tool", position: hit.point.toArray(), quaternion: this.quaternion, sequence, ...page.address(index) });
    } else this.send(stamp);
  }

  /** Take a tool in hand where it is, by its state {position, quaternion}. */
  static resume(scene, page, { position, quaternion: [w, x, y, z] }, { tool, index }) {
    const press = Object.create(Press.prototype);
    const turn = new three.Quaternion(x, y, z, w);
    const [first, third] = [new three.Vector3(1, 0, 0), new three.Vector3(0, 0, 1)].map((axis) => axis.applyQuaternion(turn));
    const [normal, along] = tool.kind === "capsule" ? [first, third] : [third, first];
    const point = new three.Vector3(...position);
    Object.assign(press, {
      scene, page, tool, index, hit: { point, normal }, stamp: null, lastKey: "", timeWithoutTool: 0, normal, along,
      grasps: tool.kind === "grasp", cuts: tool.kind === "scalpel", offset: new three.Vector3(), home: point.clone(), depth: 0, approach: 0,
      least: -Infinity, way: 1, trail: 0, bias: 0, growth: null, age: 0, touched: true, leaving: false, unknown: true,
    });
    if (press.cuts) press.bias = scene.body.atRest.around(point.toArray(), normal.toArray(), tool.length).height;
    press.begin();
    return press;
  }

  /** Take the view's directions, for the motions of a pointer. */
  begin() {
    const { scene } = this;
    this.deepest = this.cuts ? deepestStroke(this.tool.length) : 0.2 * scene.size;
    this.viewAxes = [0, 1].map((k) => new three.Vector3().setFromMatrixColumn(scene.camera.matrixWorld, k));
    this.scale = scene.metresPerPixel(this.hit.point);
  }

  /** Pose at which a tool just touches the surface, turned around the normal by a roll [rad] from the view's right. */
  static initialPose(scene, tool, hit, roll = 0) {
    const { normal } = hit;
    const along = flatten(new three.Vector3().setFromMatrixColumn(scene.camera.matrixWorld, 0), normal).applyAxisAngle(normal, roll);
    const round = tool.outline ? -Math.min(...tool.outline.map(([, height]) => height)) : tool.kind === "sphere" || tool.kind === "capsule" ? tool.radius : 0;
    return { position: hit.point.clone().addScaledVector(normal, round), quaternion: turned(tool.kind, normal, along), along };
  }

  get position() {
    return this.home.clone().add(this.offset).addScaledVector(this.normal, this.approach - this.depth);
  }

  /** How deep a ball or a capsule at a position is [m], from where it touches the surface at rest; null where that is not known. */
  depthAt(position) {
    if (this.grasps || this.cuts || this.unknown) return null;
    return depthAt(this.home.clone().add(this.offset).toArray(), this.normal.toArray(), position);
  }

  get quaternion() {
    if (this.tool.kind === "group") {
      const { w, x, y, z } = new three.Quaternion().setFromAxisAngle(this.normal, this.turn);
      return [w, x, y, z]; // from rest
    }
    return turned(this.tool.kind, this.normal, this.along);
  }

  /** Drag by pixels: down presses deeper, sideways moves along the surface; forceps and blades follow the pointer. */
  drag(dx, dy, stamp) {
    if (this.grasps) {
      this.offset.addScaledVector(this.viewAxes[0], dx * this.scale).addScaledVector(this.viewAxes[1], -dy * this.scale);
    } else if (this.cuts) this.stroke(dx * this.scale, -dy * this.scale);
    else {
      this.shift(this.viewAxes[0], dx * this.scale);
      this.growth?.drag(dy);
      this.depth = Math.min(Math.max(this.depth + 0.7 * dy * this.scale, this.least), this.deepest);
    }
    this.send(stamp);
  }

  /** Move along the surface by metres in the view's directions. */
  slide(right, up, stamp) {
    if (this.cuts) this.stroke(right, up);
    else {
      this.shift(this.viewAxes[0], right);
      this.shift(this.viewAxes[1], up);
    }
    this.send(stamp);
  }

  shift(direction, metres) {
    const { normal } = this;
    const flat = this.grasps ? direction : direction.clone().addScaledVector(normal, -direction.dot(normal));
    this.offset.addScaledVector(flat, metres).clampLength(0, 0.5 * this.scene.size);
  }

  /** Lead a blade along the surface under the pointer, upright on it, and turn its edge into the stroke. */
  stroke(right, up) {
    const { normal, along, home, offset, scene } = this;
    const { length } = this.tool;
    const step = new three.Vector3().addScaledVector(this.viewAxes[0], right).addScaledVector(this.viewAxes[1], up);
    const view = home.clone().add(offset).sub(scene.camera.position).normalize();
    const slope = Math.min(view.dot(normal), -MIN_SLOPE);
    step.addScaledVector(view, -step.dot(normal) / slope);
    const metres = step.length();
    if (!(metres > 0)) return;
    offset.add(step).clampLength(0, STROKE_REACH * scene.size);
    const forward = step.dot(along) < 0 ? -1 : 1; // it cuts to both sides
    const side = new three.Vector3().crossVectors(normal, along);
    const turn = Math.atan2(forward * step.dot(side), forward * step.dot(along));
    along.applyAxisAngle(normal, turn * (1 - Math.exp(-metres / (TURN_WAY * length))));
    this.trail = Math.min(Math.max(this.trail + step.dot(along), -REVERSE_WAY * length), REVERSE_WAY * length);
    if (Math.abs(this.trail) > 0.99 * REVERSE_WAY * length) this.way = Math.sign(this.trail);
    const rest = scene.body.atRest.around(home.clone().add(offset).toArray(), normal.toArray(), length);
    offset.addScaledVector(normal, rest.height - this.bias);
    normal.fromArray(rest.normal);
    flatten(along, normal);
  }

  /** Turn the tool around the normal of the surface by an angle [rad]. */
  roll(angle, stamp) {
    this.along.applyAxisAngle(this.normal, angle);
    this.turn += angle;
    this.send(stamp);
  }

  /** Let the depth grow no more. */
  stopGrowth() {
    this.growth = null;
  }

  /** End a press, which first touches the body where it was short; returns whether it goes on until then. */
  leave() {
    const short = !this.grasps && !this.cuts && !this.touched && this.age < SHORT_TIME && this.depth > 0;
    this.stopGrowth();
    this.leaving = short;
    return short;
  }

  deepen(metres, stamp) {
    this.stopGrowth();
    this.depth = Math.min(Math.max(this.depth + metres, Math.max(this.least, -this.deepest)), this.deepest);
    this.send(stamp);
  }

  send(stamp) {
    const [position, quaternion] = [this.position.toArray(), this.quaternion];
    const key = [position, quaternion].join();
    if (key === this.lastKey) return;
    this.lastKey = key;
    sequence += 1;
    this.page.poseSent(sequence, stamp);
    this.page.send({ type: "pose", position, quaternion, sequence, ...this.page.address(this.index) });
    this.scene.dirty = true;
  }

  /** Go on by a time [s], by the state of the session and of this tool; of a slow page by less, as a tool follows each pose within that. */
  update(time, state, tool) {
    const seconds = Math.min(time, FOLLOW_TIME);
    this.age += seconds;
    this.touched ||= tool.newtons > TOUCH_FORCE && tool.pose >= this.first;
    this.grow(seconds);
    // the server does not put a tool down inside the body: retry from farther away
    const gone = !this.grasps && state?.state === "running" && tool.kind === "none";
    this.timeWithoutTool = gone ? this.timeWithoutTool + seconds : 0;
    if (this.timeWithoutTool > RETRY_TIME) {
      this.timeWithoutTool = 0;
      this.approach = Math.min(2 * this.approach + 2 * APPROACH_GAP, 0.5 * this.scene.size) + this.depth;
      this.send(null);
    } else if (this.approach > 0 && !this.timeWithoutTool) {
      this.approach = this.approach < 1e-5 ? 0 : this.approach * Math.exp(-seconds / APPROACH_TIME);
      this.send(null);
    }
  }

  /** Press deeper while a click is held, from when it touches. */
  grow(seconds) {
    if (!this.growth || this.growth.over) return this.stopGrowth();
    if (this.approach > TOUCH_GAP) return;
    this.depth = Math.min(this.depth + this.growth.update(seconds), this.deepest);
    this.send(null);
  }
}

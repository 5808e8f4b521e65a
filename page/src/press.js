// One press, from contact to release: the pose of the tool, and the messages to the server.
import * as three from "three";

const APPROACH_GAP = 0.008; // [m] between surface and tool at the start, so that the tool is outside the body
const APPROACH_TIME = 0.07; // [s], time constant
const RETRY_TIME = 0.3; // [s] without an active tool before a retry from farther away

let sequence = 0;

export class Press {
  constructor(scene, page, hit, stamp) {
    Object.assign(this, { scene, page, hit, stamp, lastKey: "", timeWithoutTool: 0 });
    this.tool = page.tool();
    this.grasps = this.tool.kind === "grasp" || this.tool.kind === "group";
    this.offset = new three.Vector3(); // along the surface; for forceps in any direction
    this.depth = this.grasps || this.tool.kind === "scalpel" ? 0 : Math.min(0.35 * this.tool.radius, 0.02 * scene.size);
    this.approach = this.grasps ? 0 : this.depth + APPROACH_GAP;
    this.deepest = 0.2 * scene.size;
    this.viewAxes = [0, 1].map((k) => new three.Vector3().setFromMatrixColumn(scene.camera.matrixWorld, k));
    this.scale = scene.metresPerPixel(hit.point);
    const { position, quaternion } = Press.initialPose(scene, this.tool, hit);
    this.home = this.tool.kind === "group" ? new three.Vector3(...this.tool.position) : position;
    this.quaternion = quaternion;
    if (this.tool.kind === "grasp") {
      sequence += 1;
      page.send({ ...this.tool, type: "tool", position: hit.point.toArray(), quaternion, sequence });
    } else this.send(stamp);
  }

  /** Pose at which a tool just touches the surface: z outwards, or for a capsule x outwards and z along it. */
  static initialPose(scene, tool, hit) {
    const { normal } = hit;
    const right = new three.Vector3().setFromMatrixColumn(scene.camera.matrixWorld, 0);
    const along = right.addScaledVector(normal, -right.dot(normal)).normalize();
    const third = new three.Vector3().crossVectors(normal, along);
    const basis = new three.Matrix4();
    if (tool.kind === "capsule") basis.makeBasis(normal, third.negate(), along);
    else basis.makeBasis(along, third, normal);
    const { w, x, y, z } = new three.Quaternion().setFromRotationMatrix(basis);
    const round = tool.outline ? -Math.min(...tool.outline.map(([, height]) => height)) : tool.kind === "sphere" || tool.kind === "capsule" ? tool.radius : 0;
    return { position: hit.point.clone().addScaledVector(normal, round), quaternion: [w, x, y, z] };
  }

  get position() {
    return this.home.clone().add(this.offset).addScaledVector(this.hit.normal, this.approach - this.depth);
  }

  /** Drag by pixels: down presses deeper, sideways moves along the surface; forceps follow the pointer. */
  drag(dx, dy, stamp) {
    if (this.grasps) {
      this.offset.addScaledVector(this.viewAxes[0], dx * this.scale).addScaledVector(this.viewAxes[1], -dy * this.scale);
    } else {
      this.shift(this.viewAxes[0], dx * this.scale);
      this.depth = Math.min(Math.max(this.depth + 0.7 * dy * this.scale, 0), this.deepest);
    }
    this.send(stamp);
  }

  /** Move along the surface by metres in the view's directions. */
  slide(right, up, stamp) {
    this.shift(this.viewAxes[0], right);
    this.shift(this.viewAxes[1], up);
    this.send(stamp);
  }

  shift(direction, metres) {
    const { normal } = this.hit;
    const flat = this.grasps ? direction : direction.clone().addScaledVector(normal, -direction.dot(normal));
    this.offset.addScaledVector(flat, metres).clampLength(0, 0.5 * this.scene.size);
  }

  deepen(metres, stamp) {
    this.depth = Math.min(Math.max(this.depth + metres, this.grasps ? -this.deepest : 0), this.deepest);
    this.send(stamp);
  }

  send(stamp) {
    const position = this.position.toArray();
    const key = position.join();
    if (key === this.lastKey) return;
    this.lastKey = key;
    sequence += 1;
    this.page.poseSent(sequence, stamp);
    this.page.send({ type: "pose", position, quaternion: this.quaternion, sequence });
    this.scene.dirty = true;
  }

  update(seconds, state) {
    // the server does not put a tool down inside the body: retry from farther away
    const gone = !this.grasps && state?.state === "running" && state.tool === "none";
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
}

// One press, from touch to release: where the tool is, and when the server has to know.
import * as three from "three";

const AWAY = 0.008; // [m] from the surface, where a tool comes in: outside of the body, whatever its shape there
const COME = 0.07; // [s] in which it comes most of the way
const PATIENCE = 0.3; // [s] without a tool after which it comes from farther away

let sequence = 0;

export class Press {
  constructor(stage, page, hit, stamp) {
    Object.assign(this, { stage, page, hit, stamp, sent: "", missing: 0 });
    this.tool = page.tool();
    this.pulls = this.tool.kind === "grasp" || this.tool.kind === "group";
    this.offset = new three.Vector3(); // along the surface; of forceps, in any direction
    this.depth = this.pulls ? 0 : Math.min(0.35 * this.tool.radius, 0.02 * stage.size);
    this.approach = this.pulls ? 0 : this.depth + AWAY;
    this.deepest = 0.2 * stage.size;
    this.across = [0, 1].map((k) => new three.Vector3().setFromMatrixColumn(stage.camera.matrixWorld, k));
    this.scale = stage.metresPerPixel(hit.point);
    const { position, quaternion } = Press.rest(stage, this.tool, hit);
    this.home = this.tool.kind === "group" ? new three.Vector3(...this.tool.position) : position;
    this.quaternion = quaternion;
    if (this.tool.kind === "grasp") {
      sequence += 1;
      page.send({ ...this.tool, type: "tool", position: hit.point.toArray(), quaternion, sequence });
    } else this.send(stamp);
  }

  /** Where a tool just touches the surface, and how it stands: z outwards, of a capsule x outwards and z along. */
  static rest(stage, tool, hit) {
    const { normal } = hit;
    const right = new three.Vector3().setFromMatrixColumn(stage.camera.matrixWorld, 0);
    const along = right.addScaledVector(normal, -right.dot(normal)).normalize();
    const third = new three.Vector3().crossVectors(normal, along);
    const basis = new three.Matrix4();
    if (tool.kind === "capsule") basis.makeBasis(normal, third.negate(), along);
    else basis.makeBasis(along, third, normal);
    const { w, x, y, z } = new three.Quaternion().setFromRotationMatrix(basis);
    const round = tool.kind === "sphere" || tool.kind === "capsule" ? tool.radius : 0;
    return { position: hit.point.clone().addScaledVector(normal, round), quaternion: [w, x, y, z] };
  }

  get position() {
    return this.home.clone().add(this.offset).addScaledVector(this.hit.normal, this.approach - this.depth);
  }

  /** A drag by pixels: down is deeper, sideways along the surface; forceps go with the pointer. */
  drag(dx, dy, stamp) {
    if (this.pulls) {
      this.offset.addScaledVector(this.across[0], dx * this.scale).addScaledVector(this.across[1], -dy * this.scale);
    } else {
      this.shift(this.across[0], dx * this.scale);
      this.depth = Math.min(Math.max(this.depth + 0.7 * dy * this.scale, 0), this.deepest);
    }
    this.send(stamp);
  }

  /** Along the surface by metres, as seen. */
  slide(right, up, stamp) {
    this.shift(this.across[0], right);
    this.shift(this.across[1], up);
    this.send(stamp);
  }

  shift(direction, metres) {
    const { normal } = this.hit;
    const flat = this.pulls ? direction : direction.clone().addScaledVector(normal, -direction.dot(normal));
    this.offset.addScaledVector(flat, metres).clampLength(0, 0.5 * this.stage.size);
  }

  deepen(metres, stamp) {
    this.depth = Math.min(Math.max(this.depth + metres, this.pulls ? -this.deepest : 0), this.deepest);
    this.send(stamp);
  }

  send(stamp) {
    const position = this.position.toArray();
    const key = position.join();
    if (key === this.sent) return;
    this.sent = key;
    sequence += 1;
    this.page.posed(sequence, stamp);
    this.page.send({ type: "pose", position, quaternion: this.quaternion, sequence });
    this.stage.dirty = true;
  }

  tick(seconds, state) {
    // a tool that the server found inside the body comes again, from farther away
    const gone = !this.pulls && state?.state === "running" && state.tool === "none";
    this.missing = gone ? this.missing + seconds : 0;
    if (this.missing > PATIENCE) {
      this.missing = 0;
      this.approach = Math.min(2 * this.approach + 2 * AWAY, 0.5 * this.stage.size) + this.depth;
      this.send(null);
    } else if (this.approach > 0 && !this.missing) {
      this.approach = this.approach < 1e-5 ? 0 : this.approach * Math.exp(-seconds / COME);
      this.send(null);
    }
  }
}

// The force over the depth of the present press; it is kept until the next one.

const MIN_STEP = 1e-5; // [m] of the depth between points
const MIN_FORCE_STEP = 2e-3; // [N] between points
const MAX_POINTS = 3000;

export class PressCurve {
  constructor() {
    Object.assign(this, { press: null, depths: [], forces: [] });
  }

  /** Add a depth [m] and a force [N] of a press; the force is null where it is not known. */
  add(press, depth, newtons) {
    const { depths, forces } = this;
    if (press !== this.press) {
      this.press = press;
      depths.length = forces.length = 0;
    }
    if (depth < 0) return;
    const near = Math.abs(1e3 * depth - depths.at(-1)) < 1e3 * MIN_STEP && Math.abs((newtons ?? Infinity) - (forces.at(-1) ?? Infinity)) < MIN_FORCE_STEP;
    if (near) return;
    depths.push(1e3 * depth);
    forces.push(newtons);
    if (depths.length > MAX_POINTS) for (const list of [depths, forces]) list.splice(0, list.length, ...list.filter((_, k) => k % 2 === 0));
  }

  clear() {
    this.press = null;
    this.depths.length = this.forces.length = 0;
  }
}

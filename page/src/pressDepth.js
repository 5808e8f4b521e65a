// The depth of a press: that of a click, which grows while it is held, and that of the tool.

const LIGHT_DEPTH = 1e-3; // [m] of a click at its start
const GROWTH_TIME = 0.8; // [s] in which a click that is held grows to its full depth
const STEER_WAY = 4; // [px] of a drag down or up that takes the depth over

/** The depth of a click that grows to `full` [m] while it is held, unless a drag takes the depth over. */
export class Growth {
  constructor(full) {
    Object.assign(this, { full, light: Math.min(LIGHT_DEPTH, full), time: 0, way: 0 });
  }

  get over() {
    return this.time >= GROWTH_TIME || Math.abs(this.way) > STEER_WAY;
  }

  /** Go on by a time [s]; returns by how much the depth grows [m]. */
  update(seconds) {
    const before = this.depth;
    this.time = Math.min(this.time + seconds, GROWTH_TIME);
    return this.depth - before;
  }

  /** Take a drag down by pixels. */
  drag(dy) {
    this.way += dy;
  }

  get depth() {
    const share = this.time / GROWTH_TIME;
    return this.light + (this.full - this.light) * share * share * (3 - 2 * share);
  }
}

/** The depth [m] of a tool at a position, along the outward normal from the place at which it touches the surface at rest. */
export function depthAt(touching, normal, position) {
  return touching.reduce((sum, part, k) => sum + (part - position[k]) * normal[k], 0);
}

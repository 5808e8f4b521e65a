// Pixels for speed: a machine that cannot draw all of them in time draws fewer.

const SLOW = 0.026; // [s] between pictures, in the mean
const FAST = 0.014;
const FEW = 24; // pictures before fewer pixels, ten times as many before more

export class Sharpness {
  constructor(full, fixed) {
    Object.assign(this, { full, fixed, ratio: full, mean: 0.016, count: 0 });
  }

  /** Note the time from one picture to the next; returns whether the ratio has changed. */
  spent(seconds) {
    if (this.fixed || seconds > 0.25) return false; // a tab that was asleep tells nothing
    this.mean += 0.1 * (seconds - this.mean);
    this.count += 1;
    const before = this.ratio;
    if (this.mean > SLOW && this.count > FEW) this.ratio = Math.max(this.ratio * 0.8, 0.6);
    else if (this.mean < FAST && this.count > 10 * FEW) this.ratio = Math.min(this.ratio * 1.25, this.full);
    if (this.ratio !== before) this.count = 0;
    return this.ratio !== before;
  }
}

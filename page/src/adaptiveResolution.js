// Adaptive resolution: renders fewer pixels on a machine that cannot keep the frame rate.

const SLOW_FRAME = 0.026; // [s], mean time between frames
const FAST_FRAME = 0.014;
const FRAMES_BEFORE_DECREASE = 24; // ten times as many before an increase

export class AdaptiveResolution {
  constructor(full, fixed) {
    Object.assign(this, { full, fixed, ratio: full, mean: 0.016, count: 0 });
  }

  /** Add the time of a frame [s]; returns whether the pixel ratio has changed. */
  addFrame(seconds) {
    if (this.fixed || seconds > 0.25) return false; // ignores pauses of a hidden tab
    this.mean += 0.1 * (seconds - this.mean);
    this.count += 1;
    const before = this.ratio;
    if (this.mean > SLOW_FRAME && this.count > FRAMES_BEFORE_DECREASE) this.ratio = Math.max(this.ratio * 0.8, 0.6);
    else if (this.mean < FAST_FRAME && this.count > 10 * FRAMES_BEFORE_DECREASE) this.ratio = Math.min(this.ratio * 1.25, this.full);
    if (this.ratio !== before) this.count = 0;
    return this.ratio !== before;
  }
}

// The end of the colour scale: a 99th percentile, smoothed, rounded to 1, 2 or 5, with hysteresis.

const RISE_TIME = 0.15; // [s], time constant of the smoothed percentile when it rises
const FALL_TIME = 8; // when it falls
const GLIDE_TIME = 0.12; // of the end that colours use, towards the rounded one
const SHRINK_SHARE = 0.8; // of the next smaller end, below which the scale shrinks

const STEPS = [1, 2, 5, 10];

/** Round a positive number up to 1, 2 or 5 times a power of ten. */
export function roundUp(value) {
  if (!(value > 0)) return 0;
  const decade = 10 ** Math.floor(Math.log10(value) + 1e-9);
  return Number((decade * STEPS.find((step) => value <= step * decade * (1 + 1e-9))).toPrecision(1));
}

const approach = (from, to, seconds, time) => to + (from - to) * Math.exp(-seconds / time);

export class ColourScale {
  /** `least` is the smallest end of the scale, which hides noise of a body at rest. */
  constructor(least) {
    this.least = least;
    this.smoothed = 0; // the percentile
    this.end = roundUp(least); // rounded: the number of the legend
    this.shown = this.end; // what colours use; it glides to `end`
  }

  /** Update by the percentile of a state, after some seconds; returns the end that colours use. */
  update(percentile, seconds) {
    this.smoothed = approach(this.smoothed, percentile, seconds, percentile > this.smoothed ? RISE_TIME : FALL_TIME);
    const wanted = roundUp(Math.max(this.smoothed, this.least));
    if (wanted > this.end) this.end = wanted;
    else if (wanted < this.end && this.smoothed < SHRINK_SHARE * nextBelow(this.end)) this.end = nextBelow(this.end);
    this.shown = Math.exp(approach(Math.log(this.shown), Math.log(this.end), seconds, GLIDE_TIME));
    return this.shown;
  }
}

function nextBelow(end) {
  const digit = Math.round(end / 10 ** Math.floor(Math.log10(end) + 1e-9));
  return Number((end * { 1: 0.5, 2: 0.5, 5: 0.4 }[digit]).toPrecision(1));
}

// Scale bar, legend, and how fast the page itself is.
import { gradient, roundUp } from "./colours.js";
import { TISSUE } from "./organ.js";

const LONGEST = 120; // [px] of the scale bar
const KEPT = 4096;

export function showScale(byId, metresPerPixel) {
  const longest = 1e3 * LONGEST * metresPerPixel;
  if (!(longest > 0)) return;
  const decade = 10 ** Math.floor(Math.log10(longest));
  const length = decade * [5, 2, 1].find((step) => step * decade <= longest);
  byId("scale-bar").style.width = `${(length / 1e3 / metresPerPixel).toFixed(1)}px`;
  byId("scale-text").textContent = `${Number(length.toPrecision(1))} mm`;
  byId("scale").setAttribute("aria-label", `Scale bar: ${Number(length.toPrecision(1))} millimetres`);
}

/** The range that is shown: it grows at once, shrinks slowly, and ends at round numbers. */
export class Legend {
  constructor(byId) {
    this.byId = byId;
    this.reset(null);
  }

  reset(scalar) {
    this.scalar = scalar;
    this.peaks = [0, 0];
    this.shown = "";
    this.byId("legend").hidden = true;
  }

  /** Take a state's range; returns the range to colour by in the server's unit, or null. */
  range(state, seconds) {
    const { scalar } = this;
    if (!scalar || !state.scalar) return null;
    const fade = Math.exp(-seconds / 6);
    const ends = [-state.low, state.high].map((end, k) => Math.max(end, 0, this.peaks[k] * fade));
    this.peaks = ends;
    const factor = scalar.factor ?? 1;
    const least = LEAST[scalar.unit] ?? 0;
    const largest = Math.max(...ends) * factor;
    const high = roundUp(Math.max(largest, least));
    const low = ends[0] > 0.02 * Math.max(...ends) && ends[0] * factor > 0.02 * least ? -high : 0;
    this.show(low, high, scalar);
    return [low / factor, high / factor];
  }

  show(low, high, { name, unit, note }) {
    const key = [low, high, name].join();
    if (key === this.shown) return;
    this.shown = key;
    const write = (id, text) => (this.byId(id).textContent = text);
    write("legend-name", `${name[0].toUpperCase()}${name.slice(1)}, ${unit}`);
    write("legend-note", note ?? "");
    write("legend-low", Number(low.toPrecision(3)).toString().replace("-", "−"));
    write("legend-high", Number(high.toPrecision(3)).toString());
    this.byId("legend-bar").style.background = gradient([low, high], TISSUE);
    this.byId("legend").hidden = false;
  }
}

const LEAST = { mm: 1, kPa: 0.2, Pa: 200 }; // the smallest range: rest is not to glitter

/** Times of pictures with a new state, and from a pointer's event to the picture that shows its effect. */
export class Meter {
  constructor() {
    Object.assign(this, { pictures: [], latencies: [], waiting: new Map(), pending: null });
  }

  posed(sequence, stamp) {
    if (stamp !== null && stamp !== undefined) this.waiting.set(sequence, stamp);
  }

  /** A state was given to the graphics card; `presented` is called with the next picture. */
  drawn(state) {
    this.pending = state;
  }

  presented(now) {
    if (!this.pending) return;
    keep(this.pictures, now);
    for (const [sequence, stamp] of this.waiting) {
      if (sequence > this.pending.pose) break;
      this.waiting.delete(sequence);
      keep(this.latencies, now - stamp);
    }
    this.pending = null;
  }

  reset() {
    this.pictures.length = this.latencies.length = 0;
    this.waiting.clear();
  }

  summary() {
    const [first, last] = [this.pictures[0], this.pictures.at(-1)];
    const sorted = [...this.latencies].sort((a, b) => a - b);
    const at = (share) => (sorted.length ? sorted[Math.ceil(share * sorted.length) - 1] : null);
    return {
      pictures: this.pictures.length,
      rate: this.pictures.length > 1 ? (1000 * (this.pictures.length - 1)) / (last - first) : 0,
      latencies: sorted.length,
      median: at(0.5),
      p95: at(0.95),
    };
  }
}

function keep(list, item) {
  list.push(item);
  if (list.length > KEPT) list.splice(0, KEPT / 2);
}

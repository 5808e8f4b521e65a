// Legend and scale bar.
import { gradient, roundUp } from "./colours.js";
import { TISSUE } from "./bodyMesh.js";

const MAX_BAR_WIDTH = 120; // [px]

export function updateScaleBar(byId, metresPerPixel) {
  const longest = 1e3 * MAX_BAR_WIDTH * metresPerPixel;
  if (!(longest > 0)) return;
  const decade = 10 ** Math.floor(Math.log10(longest));
  const length = decade * [5, 2, 1].find((step) => step * decade <= longest);
  byId("scale-bar").style.width = `${(length / 1e3 / metresPerPixel).toFixed(1)}px`;
  byId("scale-text").textContent = `${Number(length.toPrecision(1))} mm`;
  byId("scale").setAttribute("aria-label", `Scale bar: ${Number(length.toPrecision(1))} millimetres`);
}

/** Legend with a range that grows at once, shrinks slowly, and ends at round numbers. */
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

  /** Update the range by a state; returns the colour range in SI units, or null. */
  updateRange(state, seconds) {
    const { scalar } = this;
    if (!scalar || !state.scalar) return null;
    const fade = Math.exp(-seconds / 6);
    const ends = [-state.low, state.high].map((end, k) => Math.max(end, 0, this.peaks[k] * fade));
    this.peaks = ends;
    const factor = scalar.factor ?? 1;
    const least = MIN_RANGE[scalar.unit] ?? 0;
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
    write("legend-name", `${name[0].toUpperCase()}${name.slice(1)} [${unit}]`);
    write("legend-note", note ?? "");
    write("legend-low", Number(low.toPrecision(3)).toString().replace("-", "−"));
    write("legend-high", Number(high.toPrecision(3)).toString());
    this.byId("legend-bar").style.background = gradient([low, high], TISSUE);
    this.byId("legend").hidden = false;
  }
}

const MIN_RANGE = { mm: 1, kPa: 0.2, Pa: 200 }; // hides noise of a body at rest

// Legend and scale bar.
import { ColourScale } from "./colourScale.js";
import { gradient } from "./colours.js";
import { sideLetters, sideWords } from "./sides.js";

const MAX_BAR_WIDTH = 120; // [px]
const MIN_END = { mm: 1, kPa: 0.2, Pa: 200 }; // hides noise of a body at rest

/** Show the scale, and the sides of the patient towards which a horizontal direction of the view points, if they are known. */
export function updateScaleBar(byId, metresPerPixel, space, direction) {
  const longest = 1e3 * MAX_BAR_WIDTH * metresPerPixel;
  if (!(longest > 0)) return;
  const decade = 10 ** Math.floor(Math.log10(longest));
  const length = decade * [5, 2, 1].find((step) => step * decade <= longest);
  byId("scale-bar").style.width = `${(length / 1e3 / metresPerPixel).toFixed(1)}px`;
  byId("scale-text").textContent = `${Number(length.toPrecision(1))} mm`;
  const letters = sideLetters(space, direction) ?? ["", ""];
  ["side-left", "side-right"].forEach((id, k) => (byId(id).textContent = letters[k]));
  const sides = letters[0] && `; the patient's ${sideWords(letters[0])} is on the left of the picture`;
  byId("scale").setAttribute("aria-label", `Scale bar: ${Number(length.toPrecision(1))} millimetres${sides}`);
}

/** Legend of the shown scalar, with the end of its scale. */
export class Legend {
  constructor(byId) {
    this.byId = byId;
    this.reset(null);
  }

  reset(scalar) {
    this.scalar = scalar;
    this.scale = new ColourScale(MIN_END[scalar?.unit] ?? 1e-3);
    this.shown = "";
    this.byId("legend").hidden = true;
  }

  /** Update the scale by a state; returns the colour range in SI units, or null. */
  updateRange(state, seconds) {
    const { scalar, scale } = this;
    if (!scalar || !state.scalar) return null;
    const factor = scalar.factor ?? 1;
    const end = scale.update(state.high * factor, seconds) / factor;
    this.show(scale.end, scalar);
    return [scalar.signed ? -end : 0, end];
  }

  show(end, { name, unit, note, signed }) {
    const key = [end, name].join();
    if (key === this.shown) return;
    this.shown = key;
    const write = (id, text) => (this.byId(id).textContent = text);
    write("legend-name", `${name[0].toUpperCase()}${name.slice(1)} [${unit}]`);
    write("legend-note", note ?? "");
    write("legend-low", signed ? `−${end}` : "0");
    write("legend-middle", signed ? "0" : "");
    write("legend-high", String(end));
    this.byId("legend-bar").style.background = gradient(signed);
    this.byId("legend").hidden = false;
  }
}

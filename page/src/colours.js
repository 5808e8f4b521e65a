// The colour map of shader and legend: viridis, as a polynomial by M. Zucker (public domain).

const TERMS = [
  [0.2777273272234177, 0.005407344544966578, 0.3340998053353061],
  [0.1050930431085774, 1.404613529898575, 1.384590162594685],
  [-0.3308618287255563, 0.214847559468213, 0.09509516302823659],
  [-4.634230498983486, -5.799100973351585, -19.33244095627987],
  [6.228269936347081, 14.17993336680509, 56.69055260068105],
  [4.776384997670288, -13.74514537774601, -65.35303263337234],
  [-5.435455855934631, 4.645852612178535, 26.3124352495832],
];

/** Colour at t in 0..1, as sRGB components in 0..1. */
export function viridis(t) {
  return [0, 1, 2].map((k) => TERMS.reduceRight((sum, term) => sum * t + term[k], 0));
}

const vector = (term) => `vec3(${term.map((part) => part.toFixed(8)).join(", ")})`;
export const VIRIDIS = `vec3 viridis(float t) {
  return ${TERMS.slice(0, -1).map((term) => `${vector(term)} + t * (`).join("")}${vector(TERMS.at(-1))}${")".repeat(6)};
}`;

/** Opacity of the colour map over the tissue: 0 near a value of 0, and 1 everywhere for scalars of both signs. */
export const COVER = `float cover(float value, vec2 range) {
  return range.x < 0.0 ? 1.0 : smoothstep(0.0, 0.16, value / max(range.y, 1e-30));
}`;

const smooth = (x) => {
  const t = Math.min(Math.max(x, 0), 1);
  return t * t * (3 - 2 * t);
};

/** CSS gradient of the legend over tissue of an sRGB colour (components in 0..1). */
export function gradient([low], tissue, stops = 24) {
  const colours = Array.from({ length: stops + 1 }, (_, k) => {
    const share = low < 0 ? 1 : smooth(k / stops / 0.16);
    const parts = viridis(k / stops).map((part, j) => 255 * (share * part + (1 - share) * tissue[j]));
    return `rgb(${parts.map(Math.round).join(" ")})`;
  });
  return `linear-gradient(to right, ${colours.join(", ")})`;
}

const STEPS = [1, 2, 3, 5, 10];

/** Round a positive number up to 1, 2, 3, 5 or 10 times a power of ten. */
export function roundUp(value) {
  if (!(value > 0)) return 0;
  const decade = 10 ** Math.floor(Math.log10(value) + 1e-9);
  return decade * STEPS.find((step) => value <= step * decade * (1 + 1e-9));
}

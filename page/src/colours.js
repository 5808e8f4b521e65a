// Colour maps of shader and legend, made for red tissue: zero is the colour of the tissue at rest.

export const TISSUE = [0.43, 0.15, 0.12]; // reflectance of tissue, sRGB
const FRONT = [1.76, 1.61, 1.58]; // light of the shader on tissue that faces the eye
const FLAT = 1.02; // the same where values are shown, in which the light is flatter
const FLAT_FROM = 0.35; // share of the range at which the light is flat

const linear = (part) => part ** 2.2;
const encoded = (part) => (part <= 0.0031308 ? 12.92 * part : 1.055 * part ** (1 / 2.4) - 0.055);

/** Tissue at rest as it is drawn, and the colours of 1/4, 2/4, 3/4 and 4/4 of the range; sRGB. */
const ZERO = TISSUE.map((part, k) => encoded(FRONT[k] * linear(part)));
const ABOVE = [[0.76, 0.32, 0.11], [0.91, 0.53, 0.16], [0.97, 0.76, 0.38], [1, 0.96, 0.82]];
const BELOW = [[0.4, 0.35, 0.55], [0.36, 0.52, 0.8], [0.56, 0.76, 0.95], [0.86, 0.96, 1]];

const share = (x) => Math.min(Math.max(x, 0), 1);
const mix = (a, b, t) => a.map((part, k) => part + t * (b[k] - part));

/** Colour at t in -1..1 as it is drawn on tissue that faces the eye, sRGB components in 0..1. */
export function colourAt(t) {
  const arm = t < 0 ? BELOW : ABOVE;
  return arm.reduce((colour, next, k) => mix(colour, next, share(4 * Math.abs(t) - k)), ZERO);
}

const vector = (parts) => `vec3(${parts.map((part) => part.toFixed(5)).join(", ")})`;
const STOPS = [...BELOW.toReversed(), ZERO, ...ABOVE]; // from -1 to 1

/** GLSL: `colourAt`; `flatness` of the light; `reflectance`, linear, that appears as a colour in that light. */
export const COLOUR_MAP = `
const vec3 STOPS[${STOPS.length}] = vec3[](${STOPS.map(vector).join(", ")});
vec3 colourAt(float t) {
  float place = 4.0 * t + 4.0;
  int k = clamp(int(place), 0, ${STOPS.length - 2});
  return mix(STOPS[k], STOPS[k + 1], place - float(k));
}
float flatness(float t) { return smoothstep(0.0, ${FLAT_FROM}, abs(t)); }
vec3 reflectance(float t) { return linear(colourAt(t)) / mix(${vector(FRONT)}, vec3(${FLAT}), flatness(t)); }`;

/** CSS gradient of the legend, from zero or from minus the range. */
export function gradient(signed, stops = 32) {
  const colours = Array.from({ length: stops + 1 }, (_, k) => {
    const parts = colourAt(signed ? (2 * k) / stops - 1 : k / stops);
    return `rgb(${parts.map((part) => Math.round(255 * part)).join(" ")})`;
  });
  return `linear-gradient(to right, ${colours.join(", ")})`;
}

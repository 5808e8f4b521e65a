// The force in words: as many digits as its error bound supports.

const BEYOND_UNTIL = 0.92; // of the largest error indicator with a bound, at which the page returns to numbers
const SUPPORTED = 1.15; // largest step of the digits, in bounds
const END_TOLERANCE = 0.25; // in steps, by which a rounded end may be inside the exact one

const MIN_DEPTH = 2e-4; // [m] of a press that has a depth and a stiffness
const MIN_FORCE = 5e-3; // [N] of a press that has a stiffness

export const BEYOND = "Beyond what the model was trained on: no force can be given here. Ease off.";
export const THROUGH = "The tool slipped through the surface: let go.";
export const FULL = "Full model: no error of reduction.";
export const NOT_MEASURED = "The error of this model was not measured.";
export const WITH_NODES = "With the error of the nodes.";
export const NODES_NOT_KNOWN = "Without the error of the nodes, which is not known.";
export const NOT_KNOWN = "Its error is not known yet after a motion beyond training: hold still for a moment.";

/** Whether an error indicator is above the largest with an error bound; `before` is the answer for the last state. */
export function isBeyond(trust, before, largest = 1) {
  return trust > (before ? BEYOND_UNTIL : 1) * largest;
}

/** What Details say of an error indicator: whether the state is like training, and its force has a bound. */
export function trustText({ trust, beyond, bound }) {
  if (beyond) return { text: "Beyond training", note: "The model was not trained on such a state." };
  if (bound === null) return { text: "After a motion beyond training", note: "The error of that motion may persist, so the bound is not known." };
  return trust > 1 ? { text: "Slightly beyond training", note: "The error bound is wider here." } : { text: "Within training", note: "" };
}

/** A force [N] without a bound: two significant digits, and no more than three decimals. */
export function plainForce(newtons) {
  const decimals = newtons < 0.00995 ? 2 : newtons < 0.0995 ? 3 : newtons < 0.995 ? 2 : newtons < 9.95 ? 1 : 0;
  return newtons < 0.005 ? "0" : newtons.toFixed(decimals);
}

/** A depth [m] in millimetres. */
export const depthText = (depth) => (1e3 * depth).toFixed(1);

/** The depth [mm] and the stiffness [N/mm], force over depth, of a press; empty where the press is shallow or the force not known. */
export function pressReading(depth, newtons, known = true) {
  if (!(depth >= MIN_DEPTH)) return { depth: "", stiffness: "" };
  const stiffness = newtons / (1e3 * depth);
  return { depth: depthText(depth), stiffness: known && newtons >= MIN_FORCE ? twoDigits(stiffness) : "" };
}

/** A number with two significant digits, without an exponent. */
const twoDigits = (value) => value.toFixed(Math.max(1 - Math.floor(Math.log10(value * 1.005)), 0));

/** The largest 1, 2 or 5 times a power of ten that an error bound supports. */
function digitStep(bound) {
  const decade = 10 ** Math.floor(Math.log10(SUPPORTED * bound));
  return decade * [5, 2, 1].find((step) => step * decade <= SUPPORTED * bound * (1 + 1e-9));
}

/** "about", "0.6" and "0.5 to 0.7" of a force and its error bound [N]; "under" and "0.2" of one that rounds to 0. */
export function boundedForce(newtons, bound) {
  const step = digitStep(bound);
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const low = step * Math.max(Math.floor((newtons - bound) / step + END_TOLERANCE), 0);
  const high = step * Math.ceil((newtons + bound) / step - END_TOLERANCE);
  const value = step * Math.round(newtons / step);
  if (value === 0) return { lead: "under", value: high.toFixed(decimals), range: "" };
  return { lead: "about", value: value.toFixed(decimals), range: `${low.toFixed(decimals)} to ${high.toFixed(decimals)}` };
}

/**
 * The reading of a force: `lead` is "about", "under" or empty, `value` [N], `range` and a `note`.
 *
 * `nodesError` is the typical error of the force by the number of nodes, relative; null where it is not known. The range
 * is that of the bound plus that error.
 * `bound` is undefined in a replay, and null where it is not known; `calibrated` says whether the error was measured,
 * `beyond` whether the state is beyond training, and `through` whether the tool is inside the body without a force.
 */
export function forceReading({ newtons, bound, full, calibrated, beyond, through, nodesError }) {
  const plain = (note) => ({ lead: "", value: plainForce(newtons), range: "", note });
  if (through || beyond) return { lead: "", value: "", range: "", note: through ? THROUGH : BEYOND };
  if (full) return plain(FULL);
  if (!calibrated) return plain(NOT_MEASURED);
  if (newtons === 0 || bound === undefined) return plain("");
  if (bound === null) return plain(NOT_KNOWN);
  const note = nodesError == null ? NODES_NOT_KNOWN : WITH_NODES;
  return { ...boundedForce(newtons, bound + (nodesError ?? 0) * newtons), note };
}

/** The forces [N] on the tool of a reduced and of a full model, or of two other bodies by their names, and how they differ. */
export function comparisonText(reduced, full, [first, second] = ["reduced", "full"]) {
  const difference = reduced - full;
  const share = full > 0.02 ? ` (${Math.round(100 * Math.abs(difference) / full)} %)` : "";
  const more = difference < 0 ? "less" : "more";
  const [own, other] = [reduced, full].map((newtons) => newtons.toFixed(2));
  return `${first} ${own} N, ${second} ${other} N: ${Math.abs(difference).toFixed(2)} N ${more}${share}`;
}

/** The pace of a body's time, or "" in real time. */
export function paceText(pace) {
  return pace < 0.95 ? `${pace < 0.1 ? pace.toPrecision(1) : pace.toFixed(1)} of real time` : "";
}

/** The size of the cut until a reset: length [m] on the surface, area [m^2] and depth [m]; and the force [N] that cuts,
 * or that the tissue tears ahead of the blade. */
export function cutText({ cut_length: length, cut_area: area, cut_depth: depth, cutting_force: needed, tears }) {
  const millimetres = (metres) => (1e3 * metres).toFixed(metres < 0.01 ? 1 : 0);
  const size = area > 0 ? `Cut: ${(1e6 * area).toFixed(area < 1e-5 ? 1 : 0)} mm², ${millimetres(length)} mm long, ${millimetres(depth)} mm deep.` : "";
  if (tears) return `${size} The tissue here is so taut that it would tear by itself: the blade needs no force.`.trim();
  const force = needed > 0 ? `The blade cuts at ${plainForce(needed)} N; below that the tissue moves with it.` : "";
  return [size, force].filter(Boolean).join(" ");
}

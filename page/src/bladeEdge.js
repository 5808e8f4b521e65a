// The edge of a scalpel, as in the session.

const BELLY_SHARE = 0.97; // sine of the angle at the ends of the edge
const OUTSIDE_SHARE = 0.1; // of the height of the edge that stays outside
export const EDGE_PARTS = 32;

/** Points [x, z] of the cutting edge of a length [m] in the frame of the tool; the deepest one is the origin. */
export function cuttingEdge(length, parts = EDGE_PARTS) {
  return Array.from({ length: parts + 1 }, (_, k) => {
    const share = (2 * k) / parts - 1;
    return [0.5 * length * share, 0.5 * length * (1 - Math.sqrt(1 - (BELLY_SHARE * share) ** 2))];
  });
}

/** Depth [m] up to which the edge of a length [m] reaches out of the surface; deeper, the surface would stay closed. */
export function deepestStroke(length) {
  return (1 - OUTSIDE_SHARE) * cuttingEdge(length)[0][1];
}

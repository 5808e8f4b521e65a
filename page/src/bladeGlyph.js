// The shape of a scalpel: a narrow blade behind the edge of the session, and a slim handle that leads along the stroke.
import * as three from "three";
import { EDGE_PARTS, cuttingEdge } from "./bladeEdge.js";

// in lengths of the edge
const NARROW = 0.16; // height of the blade behind its edge; it tapers to the point
const POINT = 0.02;
const TAPER = 0.55; // share of the edge over which it does
const GROUND = 0.45; // of the ground bevel, over the height of the blade
const THICK = 0.045;
const NECK = [0.61, 0.7]; // where the axis of the handle begins
const LEAN = 0.86; // [rad] of the handle over the surface
export const HANDLE = 2.1; // its length

/** Points of a quadratic Bezier curve without its first one. */
function bend([ax, az], [bx, bz], [cx, cz], parts = 8) {
  return Array.from({ length: parts }, (_, k) => {
    const t = (k + 1) / parts;
    const [u, v, w] = [(1 - t) ** 2, 2 * t * (1 - t), t ** 2];
    return [u * ax + v * bx + w * cx, u * az + v * bz + w * cz];
  });
}

/** A point at a way along the handle and aside of its axis. */
const onHandle = (along, aside) => [
  NECK[0] + along * Math.cos(LEAN) - aside * Math.sin(LEAN),
  NECK[1] + along * Math.sin(LEAN) + aside * Math.cos(LEAN),
];

/** Extrude an outline [x, z] in lengths of the edge by a thickness around the plane y = 0. */
function plate(outline, length, thick, rounded = 0) {
  const shape = new three.Shape(outline.map(([x, z]) => new three.Vector2(x * length, z * length)));
  const depth = Math.max(thick - 2 * rounded, 0.2 * thick) * length;
  const bevel = { bevelEnabled: rounded > 0, bevelSize: rounded * length, bevelThickness: rounded * length, bevelSegments: 3 };
  const made = new three.ExtrudeGeometry(shape, { depth, ...bevel, curveSegments: 16 });
  return made.translate(0, 0, -0.5 * depth).rotateX(Math.PI / 2);
}

/** The two ground faces between an edge and the flat of the blade, as triangles. */
function groundFaces(edge, inner, length) {
  const place = [];
  const half = 0.5 * THICK;
  for (const side of [1, -1]) {
    for (let k = 0; k + 1 < edge.length; k++) {
      const [a, b] = [edge[k], edge[k + 1]].map(([x, z]) => [x, 0, z]);
      const [c, d] = [inner[k], inner[k + 1]].map(([x, z]) => [x, side * half, z]);
      place.push(...(side > 0 ? [a, c, b, b, c, d] : [a, b, c, b, d, c]).flat());
    }
  }
  const made = new three.BufferGeometry();
  made.setAttribute("position", new three.Float32BufferAttribute(place.map((part) => part * length), 3));
  made.computeVertexNormals();
  return made;
}

/** Points at a share of the height of the blade behind its edge. */
function behind(edge, share) {
  return edge.map(([x, z], k) => {
    const [before, after] = [edge[Math.max(k - 1, 0)], edge[Math.min(k + 1, edge.length - 1)]];
    const [dx, dz] = [after[0] - before[0], after[1] - before[1]];
    const t = Math.min(k / (TAPER * (edge.length - 1)), 1);
    const height = (share * (POINT + (NARROW - POINT) * t * (2 - t))) / Math.hypot(dx, dz);
    return [x - height * dz, z + height * dx];
  });
}

/** The blade of a scalpel by the colours of its parts: flat, ground and edge. */
export function bladeParts(length) {
  const edge = cuttingEdge(1);
  const [inner, spine] = [behind(edge, GROUND), behind(edge, 1)];
  const [heel, back] = [edge.at(-1), spine.at(-1)];
  const [lower, upper] = [onHandle(0.3, -0.06), onHandle(0.3, 0.06)];
  const tang = [...bend(heel, [heel[0] + 0.05, heel[1] + 0.2], lower), upper, ...bend(upper, [back[0] + 0.05, back[1] + 0.24], back)];
  const line = new three.CatmullRomCurve3(edge.map(([x, z]) => new three.Vector3(x * length, 0, z * length)));
  return {
    flat: [plate([...inner, heel, ...tang, ...spine.toReversed().slice(1)], length, THICK)],
    ground: [groundFaces(edge, inner, length)],
    edge: [new three.TubeGeometry(line, 2 * EDGE_PARTS, 0.013 * length, 8)],
  };
}

/** The handle along x, from its neck on, by the colours of its parts. */
export function handleParts(length) {
  const slim = [[0.14, 0.075], [0.34, 0.07], [0.6, 0.1], [1.2, 0.095], [HANDLE - 0.45, 0.115], [HANDLE - 0.08, 0.1], [HANDLE, 0.05]];
  const outline = [...slim, ...slim.toReversed().map(([along, aside]) => [along, -aside])];
  const grips = Array.from({ length: 8 }, (_, k) => {
    return new three.BoxGeometry(0.026 * length, 0.13 * length, 0.21 * length).translate((0.64 + 0.07 * k) * length, 0, 0);
  });
  return { handle: [plate(outline, length, 0.115, 0.022)], grip: grips };
}

/** Put a handle where the blade of a length ends. */
export function placeHandle(group, length) {
  group.position.set(NECK[0] * length, 0, NECK[1] * length);
  group.rotation.y = -LEAN;
}

/** An arrow along x that ends at 1, of a unit length and thickness. */
export function strokeArrow() {
  const shaft = new three.CylinderGeometry(0.07, 0.07, 0.55, 12).rotateZ(-Math.PI / 2).translate(0.275, 0, 0);
  const head = new three.ConeGeometry(0.2, 0.45, 20).rotateZ(-Math.PI / 2).translate(0.775, 0, 0);
  return [shaft, head];
}

// The shape of a scalpel: a blade whose edge is that of the session, and a slim handle that leads along the stroke.
import * as three from "three";
import { EDGE_PARTS, cuttingEdge } from "./bladeEdge.js";

const GROUND = 0.12; // width of the ground bevel, and the thickness of the blade, in lengths of the edge
const THICK = 0.05;
const LEAN = 0.72; // [rad] of the handle over the surface
const NECK = [0.32, 0.62]; // where the axis of the handle begins
const HANDLE = 2.9; // its length

/** Points of a quadratic Bezier curve without its first one. */
function bend([ax, az], [bx, bz], [cx, cz], parts = 10) {
  return Array.from({ length: parts }, (_, k) => {
    const t = (k + 1) / parts;
    const [u, v, w] = [(1 - t) ** 2, 2 * t * (1 - t), t ** 2];
    return [u * ax + v * bx + w * cx, u * az + v * bz + w * cz];
  });
}

/** A point at a way along the handle and aside of its axis, in lengths of the edge. */
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

/** The parts of a scalpel by the colour that they have: flat, ground, edge, handle and grip. */
export function scalpelParts(length) {
  const edge = cuttingEdge(1);
  const [first, heel] = [edge[0], edge.at(-1)];
  const tip = [first[0] - 0.045, 0.665];
  const sharp = [tip, ...bend(tip, [first[0] - 0.028, 0.5], first, 6), ...edge.slice(1)]; // the tip goes on behind the edge
  const inner = sharp.map(([x, z], k) => {
    const [before, after] = [sharp[Math.max(k - 1, 0)], sharp[Math.min(k + 1, sharp.length - 1)]];
    const [dx, dz] = [after[0] - before[0], after[1] - before[1]];
    const width = GROUND * Math.min(1, 0.15 + k / 6) / Math.hypot(dx, dz);
    return [x - width * dz, z + width * dx];
  });
  const lower = onHandle(0.42, -0.125);
  const upper = onHandle(0.42, 0.125);
  const back = [...bend(heel, [heel[0] + 0.02, 0.56], lower, 8), ...bend(upper, onHandle(-0.05, 0.13), [-0.2, 0.5], 14), ...bend([-0.2, 0.5], [-0.38, 0.52], tip, 8)];
  const flat = plate([...inner, heel, ...back.slice(0, 8), upper, ...back.slice(8)], length, THICK);
  const line = new three.CatmullRomCurve3(edge.map(([x, z]) => new three.Vector3(x * length, 0, z * length)));
  const slim = [[0.3, 0.095], [0.55, 0.08], [0.85, 0.11], [1.7, 0.105], [HANDLE - 0.45, 0.13], [HANDLE - 0.08, 0.115], [HANDLE, 0.055]];
  const outline = [...slim.map(([along, aside]) => onHandle(along, aside)), ...slim.toReversed().map(([along, aside]) => onHandle(along, -aside))];
  const grips = Array.from({ length: 9 }, (_, k) => ridge(0.9 + 0.08 * k, length));
  return {
    flat: [flat],
    ground: [groundFaces(sharp, inner, length)],
    edge: [new three.TubeGeometry(line, 2 * EDGE_PARTS, 0.022 * length, 8)],
    handle: [plate(outline, length, 0.13, 0.025)],
    grip: grips,
  };
}

/** A ridge around the handle, at a way along it. */
function ridge(along, length) {
  const [x, z] = onHandle(along, 0);
  const made = new three.BoxGeometry(0.03 * length, 0.15 * length, 0.245 * length);
  return made.rotateY(-LEAN).translate(x * length, 0, z * length);
}

/** An arrow along x that ends at 1, of a unit length and thickness. */
export function strokeArrow() {
  const shaft = new three.CylinderGeometry(0.07, 0.07, 0.55, 12).rotateZ(-Math.PI / 2).translate(0.275, 0, 0);
  const head = new three.ConeGeometry(0.2, 0.45, 20).rotateZ(-Math.PI / 2).translate(0.775, 0, 0);
  return [shaft, head];
}

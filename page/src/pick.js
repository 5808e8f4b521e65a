// Picking: intersects a ray with the deformed body.
import * as three from "three";

const ray = new three.Raycaster();
const hit = new three.Vector3();
const [a, b, c] = [new three.Vector3(), new three.Vector3(), new three.Vector3()];

/** Nearest surface point at normalised device coordinates, with its normal and vertex; or null. */
export function pick(body, camera, x, y) {
  const [first] = crossings(body, camera, x, y);
  if (!first) return null;
  ray.ray.at(first.distance, hit);
  const corners = [0, 1, 2].map((j) => body.triangles[3 * first.triangle + j]);
  const point = hit.clone();
  return { point, distance: first.distance, vertex: closest(body, corners, point), normal: normalIn(body, corners, point) };
}

/** Fronts of triangles along a ray at normalised device coordinates, the nearest first: distances, and triangles by number. */
export function crossings({ positions, triangles }, camera, x, y) {
  ray.setFromCamera({ x, y }, camera);
  const { origin, direction } = ray.ray;
  const found = [];
  for (let k = 0; k < triangles.length; k += 3) {
    const distance = crossing(positions, 3 * triangles[k], 3 * triangles[k + 1], 3 * triangles[k + 2], origin, direction);
    if (distance < Infinity) found.push({ distance, triangle: k / 3 });
  }
  return found.sort((a, b) => a.distance - b.distance);
}

/** Distance along a ray to the front of a triangle (Moeller and Trumbore 1997), or infinity. */
function crossing(p, i, j, k, o, d) {
  const [ux, uy, uz] = [p[j] - p[i], p[j + 1] - p[i + 1], p[j + 2] - p[i + 2]];
  const [vx, vy, vz] = [p[k] - p[i], p[k + 1] - p[i + 1], p[k + 2] - p[i + 2]];
  const [qx, qy, qz] = [d.y * vz - d.z * vy, d.z * vx - d.x * vz, d.x * vy - d.y * vx];
  const determinant = ux * qx + uy * qy + uz * qz;
  if (!(determinant > 1e-20)) return Infinity;
  const [tx, ty, tz] = [o.x - p[i], o.y - p[i + 1], o.z - p[i + 2]];
  const s = (tx * qx + ty * qy + tz * qz) / determinant;
  if (s < 0 || s > 1) return Infinity;
  const [rx, ry, rz] = [ty * uz - tz * uy, tz * ux - tx * uz, tx * uy - ty * ux];
  const t = (d.x * rx + d.y * ry + d.z * rz) / determinant;
  if (t < 0 || s + t > 1) return Infinity;
  const distance = (vx * rx + vy * ry + vz * rz) / determinant;
  return distance > 0 ? distance : Infinity;
}

function closest(body, corners, point) {
  const far = (k) => a.fromArray(body.positions, 3 * k).distanceToSquared(point);
  return corners.reduce((best, k) => (far(k) < far(best) ? k : best));
}

function normalIn(body, corners, point) {
  [a, b, c].forEach((corner, j) => corner.fromArray(body.positions, 3 * corners[j]));
  const shares = three.Triangle.getBarycoord(point, a, b, c, new three.Vector3());
  const sum = new three.Vector3();
  shares?.toArray().forEach((share, j) => sum.addScaledVector(body.normalAt(corners[j]), share));
  return sum.lengthSq() > 1e-12 ? sum.normalize() : new three.Triangle(a, b, c).getNormal(sum);
}

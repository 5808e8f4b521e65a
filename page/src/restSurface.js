// The surface of a body at rest, which a blade follows: its own wound does not lead it astray.

const SAME_SIDE = 0.5; // least cosine of a normal to one of the same side; walls of a cut have less

export class RestSurface {
  /** `rest` are positions [3 n] and `triangles` corners [3 t], counter-clockwise from outside. */
  constructor(rest, triangles) {
    Object.assign(this, { rest, normals: vertexNormals(rest, triangles) });
  }

  /**
   * The surface around a point [3] on the side of a normal [3], within a radius [m].
   *
   * `height` [m] is the mean of its vertices over the point, along the normal; `normal` is their mean normal.
   */
  around([x, y, z], [u, v, w], radius) {
    const { rest, normals } = this;
    let [sum, height] = [0, 0];
    const normal = [0, 0, 0];
    for (let k = 0; k < rest.length; k += 3) {
      const [dx, dy, dz] = [rest[k] - x, rest[k + 1] - y, rest[k + 2] - z];
      const far = (dx * dx + dy * dy + dz * dz) / (radius * radius);
      if (far >= 1 || normals[k] * u + normals[k + 1] * v + normals[k + 2] * w < SAME_SIDE) continue;
      const weight = (1 - far) ** 2;
      sum += weight;
      height += weight * (dx * u + dy * v + dz * w);
      for (let j = 0; j < 3; j++) normal[j] += weight * normals[k + j];
    }
    const length = Math.hypot(...normal);
    if (!(length > 0)) return { height: 0, normal: [u, v, w] };
    return { height: height / sum, normal: normal.map((part) => part / length) };
  }
}

/** Outward unit normals [3 n] of vertices: the means over their triangles by area. */
function vertexNormals(p, triangles) {
  const normals = new Float32Array(p.length);
  for (let k = 0; k < triangles.length; k += 3) {
    const [i, j, l] = [3 * triangles[k], 3 * triangles[k + 1], 3 * triangles[k + 2]];
    const [ux, uy, uz] = [p[j] - p[i], p[j + 1] - p[i + 1], p[j + 2] - p[i + 2]];
    const [vx, vy, vz] = [p[l] - p[i], p[l + 1] - p[i + 1], p[l + 2] - p[i + 2]];
    const area = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const corner of [i, j, l]) for (let c = 0; c < 3; c++) normals[corner + c] += area[c];
  }
  for (let k = 0; k < p.length; k += 3) {
    const length = Math.hypot(normals[k], normals[k + 1], normals[k + 2]) || 1;
    for (let c = 0; c < 3; c++) normals[k + c] /= length;
  }
  return normals;
}

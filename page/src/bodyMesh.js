// The body mesh: positions are one array, shared by a buffer and a texture; the GPU computes normals.
import * as three from "three";
import { CutLine } from "./cutLine.js";
import { RestSurface } from "./restSurface.js";
import { bodyShader, normalsShader } from "./shaders.js";

const WIDTH = 128; // texels in a row of the textures, one for each vertex
const MAX_NEIGHBOURS = 12; // triangles around a vertex that contribute to its normal
const TARGET_TRIANGLES = 60_000; // after refinement of a coarse surface
const TARGET_TRIANGLES_IN_SOFTWARE = 16_000;
const MAX_SUBDIVISIONS = 5; // of an edge
const MIN_FACING = 0.6; // cosine of a normal to that of the edge of an image, at a face that it cuts off
const CULLING_COSINE = 0.35; // beyond which a curved patch is hidden

export class BodyMesh {
  constructor(renderer, geometry, { fine }) {
    this.renderer = renderer;
    this.triangles = sortAlongCurve(geometry);
    this.count = geometry.positions.length / 3;
    this.rows = Math.ceil(this.count / WIDTH);
    const size = 3 * WIDTH * this.rows;
    this.memory = new Float32Array(size);
    this.memory.set(geometry.positions);
    this.positions = this.memory.subarray(0, 3 * this.count); // present positions, used for picking
    this.rest = new Float32Array(geometry.positions);
    this.fixed = geometry.fixed; // 1 for each vertex of a support
    this.neighbours = neighbours(this.triangles, this.count, this.rows);
    this.smooth = renderer.extensions.has("EXT_color_buffer_float") || renderer.extensions.has("EXT_color_buffer_half_float");
    const wanted = Math.sqrt((fine ? TARGET_TRIANGLES : TARGET_TRIANGLES_IN_SOFTWARE) / (this.triangles.length / 3));
    this.parts = this.smooth ? Math.min(Math.max(Math.floor(wanted), 1), MAX_SUBDIVISIONS) : 1;
    this.material = this.makeMaterial(fine);
    this.mesh = this.makeMesh();
    this.texture = this.makeVectors(this.memory);
    if (this.smooth) this.makeNormals();
    if (this.parts > 1) this.refine();
    if (!fine && this.material.side === three.FrontSide) this.enableCulling();
    if (geometry.line?.ends.length) {
      this.line = new CutLine(geometry.line, this);
      this.mesh.add(this.line.mesh);
    }
    this.refresh();
  }

  /** The surface at rest. */
  get atRest() {
    this.restSurface ??= new RestSurface(this.rest, this.triangles);
    return this.restSurface;
  }

  makeMesh() {
    const shape = new three.BufferGeometry();
    const changing = (array, width) => new three.BufferAttribute(array, width).setUsage(three.DynamicDrawUsage);
    this.place = changing(this.memory, 3);
    this.scalar = changing(new Float32Array(3 * WIDTH * this.rows), 3); // scalar, and whether the vertex is fixed, and cut off
    this.fixed.forEach((fixed, k) => (this.scalar.array[3 * k + 1] = fixed));
    shape.setAttribute("position", this.place);
    shape.setAttribute("scalar", this.scalar);
    shape.setAttribute("rest", new three.BufferAttribute(this.rest, 3));
    shape.setIndex(new three.BufferAttribute(this.triangles, 1));
    const box = new three.Box3().setFromArray(this.rest);
    this.sphere = box.getBoundingSphere(new three.Sphere());
    this.box = box;
    this.material.uniforms.size.value = 2 * this.sphere.radius;
    this.shape = shape; // not refined, used for the shadow
    const mesh = new three.Mesh(shape, this.material);
    mesh.frustumCulled = false; // its bounds are not updated
    return mesh;
  }

  makeMaterial(fine) {
    const double = !closed(this.triangles);
    const lit = this.smooth && !fine; // lighting at vertices; creases of unrefined triangles are too short to matter
    const asked = { SMOOTH: this.smooth, FINE: fine, REFINED: this.parts > 1, LIT: lit, TWO_FACED: double };
    const defines = { WIDTH, ...Object.fromEntries(Object.entries(asked).filter(([, on]) => on)) };
    return new three.ShaderMaterial({
      glslVersion: three.GLSL3,
      vertexShader: bodyShader.vertex,
      fragmentShader: bodyShader.fragment,
      defines,
      side: double ? three.DoubleSide : three.FrontSide,
      uniforms: {
        ...Object.fromEntries(["normals", "positions", "rests", "scalars"].map((name) => [name, { value: null }])),
        range: { value: new three.Vector2(0, 1) },
        shown: { value: 0 },
        size: { value: 1 },
        veil: { value: 1 },
        viewMatrixOf: { value: new three.Matrix4() },
      },
    });
  }

  makeTexture(array, width, format = three.RedFormat, type = three.FloatType) {
    const made = new three.DataTexture(array, width, this.rows, format, type);
    made.needsUpdate = true;
    return made;
  }

  /** Make a texture of three numbers per vertex. */
  makeVectors(array) {
    const made = this.makeTexture(array, WIDTH, three.RGBFormat);
    made.internalFormat = "RGB32F";
    return made;
  }

  /** Draw instanced curved patches instead of triangles; the shader looks up their corners. */
  refine() {
    const shape = new three.InstancedBufferGeometry();
    const { places, index } = grid(this.parts);
    shape.setAttribute("position", new three.BufferAttribute(places, 3));
    shape.setIndex(index);
    shape.setAttribute("corners", new three.InstancedBufferAttribute(new Float32Array(this.triangles), 3));
    shape.instanceCount = this.triangles.length / 3;
    const rest = new Float32Array(this.memory.length);
    rest.set(this.rest);
    const { positions, rests, scalars } = this.material.uniforms;
    positions.value = this.texture;
    rests.value = this.makeVectors(rest);
    this.values = scalars.value = this.makeVectors(this.scalar.array);
    this.mesh.geometry = shape;
  }

  /** Draw only triangles that face the camera: in software rendering hidden triangles cost as much. */
  enableCulling() {
    if (this.parts > 1) this.facing = this.mesh.geometry.getAttribute("corners");
    else {
      this.mesh.geometry = new three.BufferGeometry(); // the shadow uses all triangles
      for (const name of ["position", "scalar", "rest"]) this.mesh.geometry.setAttribute(name, this.shape.getAttribute(name));
      this.facing = new three.BufferAttribute(new Uint32Array(this.triangles), 1);
      this.mesh.geometry.setIndex(this.facing);
    }
    this.facing.setUsage(three.DynamicDrawUsage);
  }

  /** Select the triangles that face the camera, before a frame. */
  cullBackFaces({ x, y, z }) {
    if (!this.facing) return;
    const { positions: p, triangles } = this;
    const { array } = this.facing;
    const slack = this.parts > 1 ? CULLING_COSINE ** 2 : 0;
    let count = 0;
    for (let k = 0; k < triangles.length; k += 3) {
      const [i, j, l] = [3 * triangles[k], 3 * triangles[k + 1], 3 * triangles[k + 2]];
      const ux = p[j] - p[i], uy = p[j + 1] - p[i + 1], uz = p[j + 2] - p[i + 2];
      const vx = p[l] - p[i], vy = p[l + 1] - p[i + 1], vz = p[l + 2] - p[i + 2];
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      const ex = x - p[i], ey = y - p[i + 1], ez = z - p[i + 2];
      const towards = nx * ex + ny * ey + nz * ez;
      const away = slack && towards ** 2 > slack * (nx * nx + ny * ny + nz * nz) * (ex * ex + ey * ey + ez * ez);
      if (towards < 0 && (away || !slack)) continue;
      array[count++] = triangles[k];
      array[count++] = triangles[k + 1];
      array[count++] = triangles[k + 2];
    }
    this.facing.clearUpdateRanges();
    this.facing.addUpdateRange(0, count);
    this.facing.needsUpdate = true;
    if (this.parts > 1) this.mesh.geometry.instanceCount = count / 3;
    else this.mesh.geometry.setDrawRange(0, count);
  }

  makeNormals() {
    this.target = new three.WebGLRenderTarget(WIDTH, this.rows, {
      type: three.HalfFloatType,
      minFilter: three.NearestFilter,
      magFilter: three.NearestFilter,
      depthBuffer: false,
    });
    const material = new three.ShaderMaterial({
      glslVersion: three.GLSL3,
      vertexShader: normalsShader.vertex,
      fragmentShader: normalsShader.fragment,
      defines: { WIDTH, MAX_NEIGHBOURS },
      uniforms: {
        positions: { value: this.texture },
        neighbours: { value: this.makeTexture(this.neighbours, MAX_NEIGHBOURS * WIDTH, three.RGIntegerFormat, three.UnsignedIntType) },
      },
      depthTest: false,
      depthWrite: false,
    });
    const screen = new three.Mesh(new three.PlaneGeometry(2, 2), material);
    screen.frustumCulled = false;
    this.pass = new three.Scene().add(screen);
    this.flat = new three.Camera();
    this.material.uniforms.normals.value = this.target.texture;
  }

  /** Update positions and scalar from a state frame. */
  update({ positions, scalar }) {
    this.memory.set(positions);
    if (scalar) {
      for (let k = 0; k < this.count; k++) this.scalar.array[3 * k] = scalar[k];
      this.scalar.needsUpdate = true;
      if (this.values) this.values.needsUpdate = true;
    }
    this.refresh();
  }

  /** Hatch the faces that lie in planes [point, normal inwards], at most a slack [m] away; returns whether there are some. */
  hatchEdges(planes, slack) {
    const edges = verticesInPlanes(this.rest, this.atRest.normals, planes, slack);
    edges.forEach((edge, k) => (this.scalar.array[3 * k + 2] = edge));
    this.scalar.needsUpdate = true;
    if (this.values) this.values.needsUpdate = true;
    return edges.includes(1);
  }

  refresh() {
    this.place.needsUpdate = true;
    this.texture.needsUpdate = true;
    if (!this.smooth) return;
    this.renderer.setRenderTarget(this.target);
    this.renderer.render(this.pass, this.flat);
    this.renderer.setRenderTarget(null);
  }

  /** Colour by the scalar over a range, or by tissue for null. */
  setColourRange(range) {
    const { shown, range: uniform } = this.material.uniforms;
    shown.value = range ? 1 : 0;
    if (range) uniform.value.set(...range);
  }

  /** Outward unit normal of the deformed surface at a vertex. */
  normalAt(vertex, result = new three.Vector3()) {
    const at = (k, into) => into.fromArray(this.positions, 3 * k);
    const [here, b, c] = [at(vertex, new three.Vector3()), new three.Vector3(), new three.Vector3()];
    result.set(0, 0, 0);
    const start = 2 * MAX_NEIGHBOURS * vertex;
    for (let k = start; k < start + 2 * MAX_NEIGHBOURS && this.neighbours[k] !== this.neighbours[k + 1]; k += 2) {
      at(this.neighbours[k], b).sub(here);
      at(this.neighbours[k + 1], c).sub(here);
      const weight = 1 / Math.max(b.lengthSq() * c.lengthSq(), 1e-30);
      result.addScaledVector(b.cross(c), weight);
    }
    return result.normalize();
  }

  /** Whether a point is inside the deformed body, by the normal of the nearest vertex. */
  isInside(point) {
    const { positions: p, count } = this;
    let [nearest, vertex] = [Infinity, 0];
    for (let k = 0; k < count; k++) {
      const distance = (p[3 * k] - point.x) ** 2 + (p[3 * k + 1] - point.y) ** 2 + (p[3 * k + 2] - point.z) ** 2;
      if (distance < nearest) [nearest, vertex] = [distance, k];
    }
    const outward = point.clone().sub(new three.Vector3().fromArray(p, 3 * vertex));
    return outward.dot(this.normalAt(vertex)) < 0;
  }

  /** Whether a vertex within a distance [m] of a vertex, at rest, is fixed. */
  isFixedNear(vertex, distance) {
    const [x, y, z] = this.rest.subarray(3 * vertex, 3 * vertex + 3);
    const near = (k) => Math.hypot(this.rest[3 * k] - x, this.rest[3 * k + 1] - y, this.rest[3 * k + 2] - z) <= distance;
    return this.fixed.some((fixed, k) => fixed && near(k));
  }

  dispose() {
    const { rests, scalars } = this.material.uniforms;
    const own = [this.line, this.mesh.geometry, this.shape, this.material, this.target, this.texture, rests.value, scalars.value];
    for (const each of own) each?.dispose();
  }
}

/** Sort triangles along a space-filling curve, so that consecutive ones share vertices. */
function sortAlongCurve({ positions, triangles }) {
  const box = new three.Box3().setFromArray(positions);
  const size = Math.max(...box.getSize(new three.Vector3()).toArray(), 1e-30);
  const keys = new Float64Array(triangles.length / 3);
  const low = box.min.toArray();
  keys.forEach((_, k) => {
    let key = 0;
    const cell = low.map((start, j) => {
      const middle = [0, 1, 2].reduce((sum, c) => sum + positions[3 * triangles[3 * k + c] + j], 0) / 3;
      return Math.floor((1023 * (middle - start)) / size);
    });
    for (let bit = 9; bit >= 0; bit--) for (const part of cell) key = 2 * key + ((part >> bit) & 1);
    keys[k] = key;
  });
  const order = Uint32Array.from(keys.keys()).sort((a, b) => keys[a] - keys[b]);
  const result = new Uint32Array(triangles.length);
  order.forEach((from, to) => result.set(triangles.subarray(3 * from, 3 * from + 3), 3 * to));
  return result;
}

/** Whether each vertex lies in one of some planes [point, normal inwards], at most a slack [m] away, and faces outwards there. */
export function verticesInPlanes(rest, normals, planes, slack) {
  const found = new Uint8Array(rest.length / 3);
  const dot = (a, k, b) => a[k] * b[0] + a[k + 1] * b[1] + a[k + 2] * b[2];
  for (const [point, normal] of planes) {
    const height = dot(point, 0, normal);
    found.forEach((_, k) => {
      if (Math.abs(dot(rest, 3 * k, normal) - height) < slack && dot(normals, 3 * k, normal) < -MIN_FACING) found[k] = 1;
    });
  }
  return found;
}

/** Subdivide a triangle: points (u, v, 0) and the triangles between them. */
function grid(parts) {
  const [places, index] = [[], []];
  const at = (i, j) => (i * (2 * parts + 3 - i)) / 2 + j; // each row is shorter by one
  for (let i = 0; i <= parts; i++) {
    for (let j = 0; j <= parts - i; j++) {
      places.push(i / parts, j / parts, 0);
      if (i + j < parts) index.push(at(i, j), at(i + 1, j), at(i, j + 1));
      if (i + j < parts - 1) index.push(at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
    }
  }
  return { places: new Float32Array(places), index };
}

/** Whether each edge has a triangle on both sides. */
function closed(triangles) {
  const seen = new Set();
  for (let k = 0; k < triangles.length; k += 3) {
    for (let j = 0; j < 3; j++) {
      const [a, b] = [triangles[k + j], triangles[k + ((j + 1) % 3)]];
      const other = b * 2 ** 26 + a;
      if (!seen.delete(other)) seen.add(a * 2 ** 26 + b);
    }
  }
  return seen.size === 0;
}

/** For each vertex, the two other corners of each triangle around it. */
function neighbours(triangles, count, rows) {
  const found = new Uint32Array(2 * MAX_NEIGHBOURS * WIDTH * rows);
  const filled = new Uint8Array(count);
  for (let k = 0; k < triangles.length; k += 3) {
    for (let j = 0; j < 3; j++) {
      const vertex = triangles[k + j];
      if (filled[vertex] === MAX_NEIGHBOURS) continue;
      const at = 2 * (MAX_NEIGHBOURS * vertex + filled[vertex]++);
      found[at] = triangles[k + ((j + 1) % 3)];
      found[at + 1] = triangles[k + ((j + 2) % 3)];
    }
  }
  return found;
}

/** The full model's surface, drawn as a wireframe over the reduced model's. */
export class Overlay {
  constructor(body, colour) {
    const shape = new three.BufferGeometry();
    this.place = new three.BufferAttribute(new Float32Array(body.rest), 3).setUsage(three.DynamicDrawUsage);
    shape.setAttribute("position", this.place);
    shape.setIndex(new three.BufferAttribute(edges(body.triangles), 1));
    const material = new three.LineBasicMaterial({ color: colour, transparent: true, opacity: 0.32, depthWrite: false });
    this.lines = new three.LineSegments(shape, material);
    this.lines.frustumCulled = false;
    this.lines.visible = false;
  }

  update(positions) {
    this.place.array.set(positions);
    this.place.needsUpdate = true;
  }
}

function edges(triangles) {
  const found = [];
  for (let k = 0; k < triangles.length; k += 3) {
    for (let j = 0; j < 3; j++) {
      const [a, b] = [triangles[k + j], triangles[k + ((j + 1) % 3)]];
      if (a < b) found.push(a, b); // a closed surface has each edge in both directions
    }
  }
  return new Uint32Array(found);
}

// The other labels around a body, drawn as translucent shapes. All have one colour, so that their order does not matter.
import * as three from "three";
import { crossings } from "./pick.js";
import { surroundingsShader } from "./shaders.js";

const KEY = "palpate-surroundings";

/** A name of a label as people read it. */
export const shapeName = (name) => name.replaceAll("_", " ").trim();

/** Shapes around a body as one mesh, made when it is first shown. */
export class Surroundings {
  /** `received` is a decoded frame: positions, triangles, sizes (triangles of each shape) and names. */
  constructor({ positions, triangles, sizes, names }) {
    Object.assign(this, { positions, triangles, names, mesh: null, marked: -1 });
    this.shapeOf = new Uint32Array(triangles.length / 3); // of each triangle
    let start = 0;
    sizes.forEach((size, k) => this.shapeOf.fill(k, start, (start += size)));
  }

  /** The mesh around the sphere of a body, in colours of the theme. */
  show({ center, radius }, accent, dark) {
    this.mesh ??= this.makeMesh();
    this.mesh.material.uniforms.middle.value.copy(center);
    this.mesh.material.uniforms.radius.value = radius;
    this.setColours(accent, dark);
    return this.mesh;
  }

  makeMesh() {
    const shape = new three.BufferGeometry();
    shape.setAttribute("position", new three.BufferAttribute(this.positions, 3));
    shape.setIndex(new three.BufferAttribute(this.triangles, 1));
    const number = new Float32Array(this.positions.length / 3);
    this.triangles.forEach((vertex, k) => (number[vertex] = this.shapeOf[Math.floor(k / 3)]));
    shape.setAttribute("number", new three.BufferAttribute(number, 1));
    shape.computeVertexNormals();
    const material = new three.ShaderMaterial({
      glslVersion: three.GLSL3,
      vertexShader: surroundingsShader.vertex,
      fragmentShader: surroundingsShader.fragment,
      uniforms: {
        colour: { value: new three.Color() },
        accent: { value: new three.Color() },
        marked: { value: this.marked },
        middle: { value: new three.Vector3() },
        radius: { value: 1 },
      },
      transparent: true,
      premultipliedAlpha: true,
      depthWrite: false,
      side: three.FrontSide,
    });
    const mesh = new three.Mesh(shape, material);
    mesh.renderOrder = 1; // over the shadow and the body
    return mesh;
  }

  setColours(accent, dark) {
    if (!this.mesh) return;
    const { uniforms } = this.mesh.material;
    uniforms.colour.value.setStyle(dark ? "#a9bccb" : "#51687c", three.LinearSRGBColorSpace); // components as given
    uniforms.accent.value.setStyle(accent, three.LinearSRGBColorSpace);
  }

  /** Mark a shape; none for -1. */
  mark(shape) {
    this.marked = shape;
    if (this.mesh) this.mesh.material.uniforms.marked.value = shape;
  }

  /** Shapes along a ray at normalised device coordinates, the nearest first, before a distance. */
  under(camera, x, y, distance = Infinity) {
    const hits = crossings(this, camera, x, y).filter((hit) => hit.distance < distance);
    return [...new Set(hits.map((hit) => this.shapeOf[hit.triangle]))];
  }

  dispose() {
    this.mesh?.geometry.dispose();
    this.mesh?.material.dispose();
  }
}

/** The section of the panel: a switch, and a list to find a shape by its name. */
export class SurroundingsPanel {
  /** `changed(shown)` follows the switch, `found(shape)` the list. */
  constructor(byId, changed, found) {
    Object.assign(this, { byId, found, asked: localStorage.getItem(KEY) !== "off" });
    byId("surroundings-shown").onchange = ({ target }) => this.set(target.checked, changed);
    byId("surroundings-names").onchange = ({ target }) => found(Number(target.value));
    this.toggle = () => byId("surroundings").hidden || this.set(!this.asked, changed);
  }

  set(shown, changed) {
    this.asked = shown;
    if (shown) localStorage.removeItem(KEY);
    else localStorage.setItem(KEY, "off");
    this.update();
    changed(shown);
  }

  /** Offer the shapes of names. */
  offer(names) {
    const { byId } = this;
    byId("surroundings").hidden = names.length === 0;
    byId("surroundings-text").textContent = `Surroundings (${names.length} ${names.length === 1 ? "shape" : "shapes"})`;
    const items = names.map((name, k) => [shapeName(name), k]).sort(([a], [b]) => a.localeCompare(b, undefined, { numeric: true }));
    byId("surroundings-names").replaceChildren(...[["None marked", -1], ...items].map(([text, value]) => new Option(text, value)));
    this.update();
  }

  mark(shape) {
    this.byId("surroundings-names").value = shape;
  }

  update() {
    this.byId("surroundings-shown").checked = this.asked;
    this.byId("surroundings-names").hidden = !this.asked;
  }
}

// The other labels around a body, drawn as translucent shapes in quiet colours by their kinds.
import * as three from "three";
import { crossings } from "./pick.js";
import { surroundingsShader } from "./shaders.js";

const KEY = "palpate-surroundings";
const KINDS = ["other", "organ", "muscle", "vessel", "bone"]; // as the shader numbers them
const COLOURS = { // in light and in dark, as near to each other that their order matters little
  other: ["#51687c", "#a9bccb"],
  organ: ["#6f5f86", "#b9aed0"],
  muscle: ["#8c5a4e", "#cfa498"],
  vessel: ["#2f6fa8", "#86b9e6"],
  bone: ["#9a7b3a", "#e3d0a0"],
};

/** The colour of a kind, and its name. */
function kindKey(kind) {
  const key = document.createElement("span");
  key.append(document.createElement("i"), kind);
  ["--light", "--dark"].forEach((name, k) => key.firstChild.style.setProperty(name, COLOURS[kind][k]));
  return key;
}

/** A name of a label as people read it. */
export const shapeName = (name) => name.replaceAll("_", " ").trim();

/** Shapes around a body as one mesh, made when it is first shown. */
export class Surroundings {
  /** `received` is a decoded frame: positions, triangles, sizes (triangles of each shape), names and kinds. */
  constructor({ positions, triangles, sizes, names, kinds }) {
    Object.assign(this, { positions, triangles, names, kinds, mesh: null, marked: -1, hovered: -1 });
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
    const number = new Float32Array((2 * this.positions.length) / 3); // of the shape, and of its kind
    const codes = this.kinds.map((kind) => Math.max(KINDS.indexOf(kind), 0));
    this.triangles.forEach((vertex, k) => {
      const of = this.shapeOf[Math.floor(k / 3)];
      number[2 * vertex] = of;
      number[2 * vertex + 1] = codes[of];
    });
    shape.setAttribute("number", new three.BufferAttribute(number, 2));
    shape.computeVertexNormals();
    const material = new three.ShaderMaterial({
      glslVersion: three.GLSL3,
      vertexShader: surroundingsShader.vertex,
      fragmentShader: surroundingsShader.fragment,
      uniforms: {
        colours: { value: KINDS.map(() => new three.Color()) },
        accent: { value: new three.Color() },
        marked: { value: this.marked },
        hovered: { value: this.hovered },
        window: { value: new three.Vector2(1, 1) },
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
    mesh.onBeforeRender = (renderer) => renderer.getDrawingBufferSize(material.uniforms.window.value);
    return mesh;
  }

  setColours(accent, dark) {
    if (!this.mesh) return;
    const { uniforms } = this.mesh.material;
    KINDS.forEach((kind, k) => uniforms.colours.value[k].setStyle(COLOURS[kind][dark ? 1 : 0], three.LinearSRGBColorSpace)); // components as given
    uniforms.accent.value.setStyle(accent, three.LinearSRGBColorSpace);
  }

  /** Mark a shape; none for -1. */
  mark(shape) {
    this.marked = shape;
    if (this.mesh) this.mesh.material.uniforms.marked.value = shape;
  }

  /** Brighten a shape that a mouse points at; none for -1. */
  hover(shape) {
    this.hovered = shape;
    if (this.mesh) this.mesh.material.uniforms.hovered.value = shape;
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
  /** `first` is whether shapes are shown until the user chooses; `changed(shown)` follows the switch, `found(shape)` the list. */
  constructor(byId, first, changed, found) {
    Object.assign(this, { byId, asked: (localStorage.getItem(KEY) ?? (first ? "on" : "off")) === "on" });
    byId("surroundings-shown").onchange = ({ target }) => this.set(target.checked, changed);
    byId("surroundings-names").onchange = ({ target }) => found(Number(target.value));
    this.toggle = () => byId("surroundings").hidden || this.set(!this.asked, changed);
  }

  set(shown, changed) {
    this.asked = shown;
    localStorage.setItem(KEY, shown ? "on" : "off");
    this.update();
    changed(shown);
  }

  /** Offer the shapes of names and kinds. */
  offer({ names, kinds }) {
    const { byId } = this;
    byId("surroundings").hidden = names.length === 0;
    byId("surroundings-text").textContent = `Surroundings (${names.length} ${names.length === 1 ? "shape" : "shapes"})`;
    const items = names.map((name, k) => [shapeName(name), k]).sort(([a], [b]) => a.localeCompare(b, undefined, { numeric: true }));
    byId("surroundings-names").replaceChildren(...[["None marked", -1], ...items].map(([text, value]) => new Option(text, value)));
    byId("surroundings-kinds").replaceChildren(...KINDS.toReversed().filter((kind) => kinds.includes(kind)).map(kindKey));
    this.update();
  }

  mark(shape) {
    this.byId("surroundings-names").value = shape;
  }

  update() {
    this.byId("surroundings-shown").checked = this.asked;
    this.byId("surroundings-names").hidden = this.byId("surroundings-kinds").hidden = !this.asked;
  }
}

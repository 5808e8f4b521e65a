// Glyphs of the tool, the force on it, and the point under the pointer.
import * as three from "three";
import { HANDLE, bladeParts, handleParts, placeHandle, strokeArrow } from "./bladeGlyph.js";
import { toolShader } from "./shaders.js";

const Z = new three.Vector3(0, 0, 1);
const HANDLE_SHARES = [1, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3]; // of the length of a handle, the first that is in the view
const VIEW_SHARE = 0.95; // of the view, in which a handle ends

function material(colour, opacity = 1, more = {}) {
  const { r, g, b } = new three.Color().setStyle(colour, three.LinearSRGBColorSpace); // components as given
  return new three.ShaderMaterial({
    glslVersion: three.GLSL3,
    vertexShader: toolShader.vertex,
    fragmentShader: toolShader.fragment,
    uniforms: { colour: { value: new three.Vector3(r, g, b) }, opacity: { value: opacity } },
    transparent: true,
    premultipliedAlpha: true,
    ...more,
  });
}

const STEEL = "#e9ecee";
const EDGE = "#e8590c"; // of a scalpel
const WARNING = "#db3329"; // where a model was not trained
const SLATE = "#5b6670"; // of the handle of the first scalpel
export const TOOL_TINTS = [STEEL, "#1fb58b", "#e2a12b", "#9775fa"]; // of tools by index

const paint = (target, style) => {
  const { r, g, b } = new three.Color().setStyle(style, three.LinearSRGBColorSpace); // components as given
  target.uniforms.colour.value.set(r, g, b);
};

/** A tool in its own frame; the tint is that of its index. */
export class ToolGlyph {
  constructor(opacity, fine, index = 0) {
    this.parts = fine ? 2 : 1; // subdivision of arcs
    this.group = new three.Group();
    this.group.visible = false;
    this.index = index;
    const made = (colour) => material(colour, opacity, { depthWrite: opacity === 1 });
    this.material = made(TOOL_TINTS[index]);
    // of a scalpel: the flat of its blade, the ground faces, the edge that cuts, its handle and the grip
    this.materials = { flat: made("#c3cad0"), ground: made("#f6f8f9"), edge: made(EDGE), handle: made(SLATE), grip: made("#23282d") };
    this.key = "";
  }

  /** Set the shape of a tool {kind, radius, length, outline} for a body of a size [m]. */
  shape({ kind, radius, length, outline }, size) {
    const key = [kind, radius, length, size, outline].join();
    if (key === this.key) return;
    this.key = key;
    this.group.traverse((part) => part.geometry?.dispose());
    this.group.clear();
    this.way = null;
    if (kind === "sphere") this.group.add(this.part(new three.SphereGeometry(radius, 24 * this.parts, 16 * this.parts)));
    else if (kind === "capsule") {
      this.group.add(this.part(new three.CapsuleGeometry(radius, length, 8 * this.parts, 20 * this.parts).rotateX(Math.PI / 2)));
    } else if (kind === "scalpel") this.scalpel(length);
    else if (outline) this.group.add(this.revolved(outline));
    else for (const side of [1, -1]) this.group.add(this.jaw(side, 0.02 * size));
  }

  /** Give the tool the tint of an index, or red beyond training. */
  tint(index, beyond = false) {
    this.index = index;
    paint(this.material, beyond ? WARNING : TOOL_TINTS[index]);
    paint(this.materials.handle, beyond ? WARNING : index ? TOOL_TINTS[index] : SLATE);
  }

  /** Draw the tool as solid or translucent as a share. */
  fade(opacity) {
    for (const each of [this.material, ...Object.values(this.materials)]) {
      each.uniforms.opacity.value = opacity;
      each.depthWrite = opacity === 1;
    }
  }

  part(shape) {
    return new three.Mesh(shape, this.material);
  }

  /** A surface of revolution around z, from radius and height of points of its outline. */
  revolved(outline) {
    const points = outline.map(([radius, height]) => new three.Vector2(radius, height));
    return this.part(new three.LatheGeometry(points, 48 * this.parts).rotateX(Math.PI / 2));
  }

  /** A blade with its handle, and the arrow of its stroke. */
  scalpel(length) {
    const parts = (shapes) => Object.entries(shapes).flatMap(([name, all]) => all.map((shape) => new three.Mesh(shape, this.materials[name])));
    this.way = new three.Group().add(...strokeArrow().map((shape) => new three.Mesh(shape, this.materials.edge)));
    this.way.scale.setScalar(0.55 * length);
    this.handle = new three.Group().add(...parts(handleParts(length)));
    placeHandle(this.handle, length);
    this.length = length;
    this.turned = new three.Group().add(...parts(bladeParts(length)), this.handle, this.way);
    this.group.add(this.turned);
    this.stroke(1, 0);
  }

  /** Shorten the handle of a scalpel, where it would leave the view of a camera. */
  keepInView(camera) {
    if (!this.way) return;
    this.handle.scale.x = 1;
    this.group.updateWorldMatrix(true, true);
    const ends = HANDLE_SHARES.map((share) => this.handle.localToWorld(new three.Vector3(share * HANDLE * this.length, 0, 0)).project(camera));
    const inside = ends.findIndex(({ x, y, z }) => Math.max(Math.abs(x), Math.abs(y)) < VIEW_SHARE && z < 1);
    this.handle.scale.x = HANDLE_SHARES.at(inside);
  }

  /** Lead a scalpel towards +x or -x of its frame, with an arrow at a height [m] above the deepest point of its edge. */
  stroke(sign, height) {
    if (!this.way) return;
    this.turned.rotation.z = sign < 0 ? Math.PI : 0; // its edge is the same on both sides
    this.way.position.set(0.68 * this.length, 0, height + 0.08 * this.length);
  }

  jaw(side, unit) {
    const along = [[0.14, 0], [0.62, 0.7], [0.85, 2], [0.62, 4.5], [0.36, 8.5]];
    const curve = new three.CatmullRomCurve3(along.map(([x, z]) => new three.Vector3(side * x * unit, 0, z * unit)));
    return this.part(new three.TubeGeometry(curve, 20 * this.parts, 0.25 * unit, 8 * this.parts).scale(1, 1.3, 1));
  }

  at(position, quaternion) {
    this.group.position.fromArray(position);
    const [w, x, y, z] = quaternion;
    this.group.quaternion.set(x, y, z, w).normalize();
  }
}

/** An arrow whose length grows with the force, up to a limit that keeps it in view. */
export class ForceArrow {
  constructor(colour) {
    this.material = material(colour, 1);
    this.shaft = new three.Mesh(new three.CylinderGeometry(1, 1, 1, 20).translate(0, 0.5, 0).rotateX(Math.PI / 2), this.material);
    this.head = new three.Mesh(new three.ConeGeometry(1, 1, 28).translate(0, 0.5, 0).rotateX(Math.PI / 2), this.material);
    this.group = new three.Group().add(this.shaft, this.head);
    this.group.renderOrder = this.shaft.renderOrder = this.head.renderOrder = 10;
    this.group.visible = false;
    // forceps are pulled into the body, so their arrow is drawn over it
    this.over = false;
    this.shaft.onBeforeRender = (renderer) => this.over && renderer.clearDepth();
  }

  setColour(style) {
    const { r, g, b } = new three.Color().setStyle(style, three.LinearSRGBColorSpace);
    this.material.uniforms.colour.value.set(r, g, b);
  }

  /** Show a force [N] at a point, outside a sphere around it, for a body of a size [m]. */
  show(from, force, newtons, size, radius, over) {
    this.over = over;
    this.group.visible = newtons > 0.005;
    if (!this.group.visible) return;
    const length = 0.34 * size * (1 - Math.exp(-newtons / 2.5)) + 0.012 * size;
    const [thin, cone] = [0.0042 * size, Math.min(0.05 * size, 0.6 * length)];
    const direction = new three.Vector3(...force).normalize();
    this.group.position.fromArray(from).addScaledVector(direction, radius);
    this.group.quaternion.setFromUnitVectors(Z, direction);
    this.shaft.scale.set(thin, thin, Math.max(length - cone, 1e-6));
    this.head.position.set(0, 0, length - cone);
    this.head.scale.set(3.1 * thin, 3.1 * thin, cone);
  }
}

/** A thin circle on the surface under the pointer. */
export class SurfaceMarker {
  constructor(colour) {
    this.material = new three.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.9, depthTest: false });
    this.mesh = new three.Mesh(new three.RingGeometry(0.9, 1, 64), this.material);
    this.mesh.renderOrder = 9;
    this.mesh.visible = false;
  }

  at(point, normal, radius) {
    this.mesh.position.copy(point);
    this.mesh.quaternion.setFromUnitVectors(Z, normal);
    this.mesh.scale.setScalar(radius);
    this.mesh.visible = true;
  }
}

// Glyphs of the tool, the force on it, and the point under the pointer.
import * as three from "three";
import { toolShader } from "./shaders.js";

const Z = new three.Vector3(0, 0, 1);

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

const STEEL = [0.914, 0.925, 0.933]; // sRGB
const EDGE = "#c8452d"; // of a scalpel
const BELLY_SHARE = 0.97; // sine of the angle at the ends of a scalpel's edge, as in the session
const WARNING = [0.86, 0.2, 0.16]; // where a model was not trained

/** A tool in its own frame. */
export class ToolGlyph {
  constructor(opacity, fine) {
    this.parts = fine ? 2 : 1; // subdivision of arcs
    this.group = new three.Group();
    this.group.visible = false;
    this.material = material("#e9ecee", opacity, { depthWrite: opacity === 1 });
    this.accent = material(EDGE, opacity, { depthWrite: opacity === 1 }); // of an edge that cuts, and its direction
    this.key = "";
  }

  /** Set the shape of a tool {kind, radius, length, outline} for a body of a size [m]. */
  shape({ kind, radius, length, outline }, size) {
    const key = [kind, radius, length, size, outline].join();
    if (key === this.key) return;
    this.key = key;
    this.group.traverse((part) => part.geometry?.dispose());
    this.group.clear();
    if (kind === "sphere") this.group.add(this.part(new three.SphereGeometry(radius, 24 * this.parts, 16 * this.parts)));
    else if (kind === "capsule") {
      this.group.add(this.part(new three.CapsuleGeometry(radius, length, 8 * this.parts, 20 * this.parts).rotateX(Math.PI / 2)));
    } else if (kind === "scalpel") this.group.add(...this.scalpel(length, 0.02 * size));
    else if (outline) this.group.add(this.revolved(outline));
    else for (const side of [1, -1]) this.group.add(this.jaw(side, 0.02 * size));
  }

  /** Colour the tool red beyond training. */
  warn(beyond) {
    this.material.uniforms.colour.value.fromArray(beyond ? WARNING : STEEL);
  }

  part(shape) {
    return new three.Mesh(shape, this.material);
  }

  /** A surface of revolution around z, from radius and height of points of its outline. */
  revolved(outline) {
    const points = outline.map(([radius, height]) => new three.Vector2(radius, height));
    return this.part(new three.LatheGeometry(points, 48 * this.parts).rotateX(Math.PI / 2));
  }

  /** A flat blade with a round belly around the origin, its edge and the direction in which it cuts, and a handle above. */
  scalpel(length, unit) {
    const flat = new three.Shape();
    const angle = Math.asin(BELLY_SHARE);
    const radius = (0.5 * length) / BELLY_SHARE;
    flat.absarc(0, radius, radius, -Math.PI / 2 - angle, -Math.PI / 2 + angle, false);
    const top = radius * (1 - Math.cos(angle)) + 0.25 * length;
    flat.lineTo(0.5 * length, top).lineTo(-0.5 * length, top).closePath();
    const thick = 0.1 * unit;
    const blade = new three.ExtrudeGeometry(flat, { depth: thick, bevelEnabled: false, curveSegments: 24 }).translate(0, 0, -thick / 2);
    const handle = new three.BoxGeometry(0.35 * length, 0.5 * unit, 4.5 * unit).translate(0, 0, top + 2.2 * unit);
    const points = Array.from({ length: 25 }, (_, k) => {
      const at = -angle + (2 * angle * k) / 24;
      return new three.Vector3(radius * Math.sin(at), 0, radius * (1 - Math.cos(at)));
    });
    const edge = new three.TubeGeometry(new three.CatmullRomCurve3(points), 24, 0.14 * unit, 8);
    const way = new three.ConeGeometry(0.3 * unit, 0.9 * unit, 16).rotateX(-Math.PI / 2).translate(0, 0, -0.9 * unit);
    return [this.part(blade.rotateX(Math.PI / 2)), this.part(handle), new three.Mesh(edge, this.accent), new three.Mesh(way, this.accent)];
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

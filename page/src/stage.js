// The picture: renderer, eye, body, instruments, shadow.
import * as three from "three";
import { Shadow } from "./shadow.js";
import { Arrow, Ring, ToolMark } from "./instruments.js";
import { Orbit } from "./orbit.js";
import { Organ, Overlay } from "./organ.js";
import { pick } from "./pick.js";
import { Sharpness } from "./sharpness.js";

/** Whether WebGL draws without a graphics card; null where there is no WebGL 2 at all. */
function drawnInSoftware() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return null;
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

export class Stage {
  constructor(canvas) {
    this.canvas = canvas;
    const software = drawnInSoftware();
    if (software === null) throw new Error("This browser has no WebGL 2, which the picture needs.");
    this.orbit = new Orbit();
    this.fine = !software || this.orbit.still; // a still picture may take its time
    this.renderer = new three.WebGLRenderer({ canvas, antialias: this.fine, alpha: true, powerPreference: "high-performance" });
    this.renderer.setClearAlpha(0);
    this.sharpness = new Sharpness(this.fine ? Math.min(devicePixelRatio, 2) : 1, this.orbit.still);
    this.scene = new three.Scene();
    this.tool = new ToolMark(1, this.fine);
    this.ghost = new ToolMark(0.5, this.fine);
    this.arrow = new Arrow("#0b7285");
    this.ring = new Ring("#0b7285");
    this.shadow = new Shadow(this.renderer, this.fine);
    this.scene.add(this.shadow.plane, this.tool.group, this.ghost.group, this.arrow.group, this.ring.mesh);
    this.organ = this.overlay = null;
    this.dirty = true;
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    this.resize();
  }

  get camera() {
    return this.orbit.camera;
  }

  /** Take another body, or the same one again after a new connection. */
  take(geometry) {
    const known = this.organ?.rest;
    const same = known?.length === geometry.positions.length && known.every((part, k) => part === geometry.positions[k]);
    if (this.organ) {
      this.scene.remove(this.organ.mesh, this.overlay.lines);
      this.organ.dispose();
    }
    this.organ = new Organ(this.renderer, geometry, { fine: this.fine });
    this.overlay = new Overlay(this.organ, this.accent ?? "#0b7285");
    this.scene.add(this.organ.mesh, this.overlay.lines);
    this.shadow.fit(this.organ);
    if (!same) this.orbit.frame(this.organ.sphere);
    this.dirty = true;
  }

  get size() {
    return this.organ ? 2 * this.organ.sphere.radius : 1;
  }

  paint(accent, dark) {
    this.accent = accent;
    this.arrow.colour(accent);
    this.ring.material.color.set(accent);
    this.overlay?.lines.material.color.set(accent);
    this.shadow.strength = dark ? 0.6 : 0.2;
    this.dirty = true;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.sharpness.ratio);
    this.renderer.setSize(width, height, false);
    this.height = height;
    this.width = width;
    this.orbit.resize(width / height, height);
    this.dirty = true;
  }

  /** Place of a pointer event in the picture, -1..1 each. */
  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [(2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height];
  }

  pick(x, y) {
    return this.organ && pick(this.organ, this.camera, x, y);
  }

  /** Where a point of space is in the picture [px]. */
  project(point) {
    const { x, y } = new three.Vector3(...point).project(this.camera);
    return [(0.5 + 0.5 * x) * this.width, (0.5 - 0.5 * y) * this.height];
  }

  metresPerPixel(point) {
    return this.orbit.metresPerPixel(this.height, point?.distanceTo(this.camera.position));
  }

  /** Draw if anything changed in these seconds; returns whether it did. */
  draw(seconds) {
    const moved = this.orbit.glide(seconds);
    if (!moved && !this.dirty) return false;
    this.dirty = false;
    if (this.sharpness.spent(seconds)) this.resize();
    if (this.organ) {
      this.organ.material.uniforms.viewMatrixOf.value.copy(this.camera.matrixWorldInverse);
      this.shadow.update(this.organ, this.camera);
      this.organ.seenFrom(this.camera.position);
    }
    this.renderer.render(this.scene, this.camera);
    return true;
  }
}

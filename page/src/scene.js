// The scene: renderer, camera, body mesh, tool glyphs, and shadow.
import * as three from "three";
import { Shadow } from "./shadow.js";
import { ForceArrow, SurfaceMarker, TOOL_TINTS, ToolGlyph } from "./toolGlyphs.js";
import { OrbitCamera } from "./camera.js";
import { BodyMesh, Overlay } from "./bodyMesh.js";
import { pick } from "./pick.js";
import { AdaptiveResolution } from "./adaptiveResolution.js";

/** Whether WebGL renders in software; null without WebGL 2. */
function usesSoftwareRendering() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return null;
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

/** Whether two spheres are about the same: of two models of a body. */
function isNear(first, second) {
  const apart = first.center.distanceTo(second.center) + Math.abs(first.radius - second.radius);
  return apart < 0.2 * first.radius;
}

const EDGE_SLACK = 0.3; // of the spacing, and the share of the size, from a face to the edge of the image that cuts it
const EDGE_SHARE = 0.006;
const PICK_SLACK = 14; // [px] around the point of a tool that is held, at which a click takes it
const raycaster = new three.Raycaster();

export class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    const software = usesSoftwareRendering();
    if (software === null) throw new Error("The page needs WebGL 2, which this browser does not support.");
    this.orbitCamera = new OrbitCamera();
    this.fine = !software || this.orbitCamera.still; // a still image may take longer
    this.renderer = new three.WebGLRenderer({ canvas, antialias: this.fine, alpha: true, powerPreference: "high-performance" });
    this.renderer.setClearAlpha(0);
    this.resolution = new AdaptiveResolution(this.fine ? Math.min(devicePixelRatio, 2) : 1, this.orbitCamera.still);
    this.graph = new three.Scene();
    this.tools = TOOL_TINTS.map((_, index) => new ToolGlyph(1, this.fine, index)); // by index
    this.arrows = TOOL_TINTS.map((tint) => new ForceArrow(tint));
    this.ghost = new ToolGlyph(0.5, this.fine);
    this.marker = new SurfaceMarker("#0b7285");
    this.shadow = new Shadow(this.renderer, this.fine);
    const groups = [...this.tools, ...this.arrows].map(({ group }) => group);
    this.graph.add(this.shadow.plane, ...groups, this.ghost.group, this.marker.mesh);
    this.body = this.overlay = this.surroundings = null;
    this.edges = { planes: [], spacing: 0, shown: false }; // at which the image cuts the body off
    this.room = 1; // around the body in the first view, over its size
    this.dirty = true;
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    this.resize();
  }

  get camera() {
    return this.orbitCamera.camera;
  }

  /** Replace the body mesh; the camera stays if the body is the same, or another model of it, its direction after a preview. */
  setBody(geometry) {
    const known = this.body?.rest;
    const same = known?.length === geometry.positions.length && known.every((part, k) => part === geometry.positions[k]);
    const before = this.body?.sphere;
    const previewed = this.body?.preview;
    if (this.body) {
      this.graph.remove(this.body.mesh, this.overlay.lines);
      this.body.dispose();
    }
    this.body = new BodyMesh(this.renderer, geometry, { fine: this.fine });
    this.overlay = new Overlay(this.body, this.accent ?? "#0b7285");
    this.graph.add(this.body.mesh, this.overlay.lines);
    this.hatchEdges();
    this.shadow.fit(this.body);
    this.body.preview = geometry.kind === 5;
    const grows = geometry.kind === 6 && before; // a cut: the view stays, as a blade is led in it
    const room = this.body.sphere.clone();
    room.radius *= this.room;
    if (!same && !grows) this.orbitCamera.fitSphere(room, previewed || (before && isNear(before, this.body.sphere)));
    this.dirty = true;
  }

  /** Hatch the faces of the body in some planes, whose nodes have a spacing [m]. */
  setEdges(planes, spacing) {
    Object.assign(this.edges, { planes, spacing });
    this.hatchEdges();
    this.dirty = true;
  }

  hatchEdges() {
    const { planes, spacing } = this.edges;
    this.edges.shown = planes.length > 0 && this.body.hatchEdges(planes, Math.max(EDGE_SLACK * spacing, EDGE_SHARE * this.size));
  }

  /** Replace the shapes around the body; drawn only where they are shown. */
  setSurroundings(surroundings, shown) {
    if (this.surroundings) {
      if (this.surroundings.mesh) this.graph.remove(this.surroundings.mesh);
      this.surroundings.dispose();
    }
    this.surroundings = surroundings;
    this.showSurroundings(shown);
  }

  showSurroundings(shown) {
    const { surroundings } = this;
    if (shown) this.graph.add(surroundings.show(this.body.sphere, this.accent, this.dark));
    else if (surroundings.mesh) this.graph.remove(surroundings.mesh);
    this.surroundingsShown = shown;
    this.dirty = true;
  }

  /** Mark a shape around the body; none for -1. */
  markShape(shape) {
    this.surroundings.mark(shape);
    this.dirty = true;
  }

  /** Brighten a shape that a mouse points at; none for -1. */
  hoverShape(shape) {
    if (!this.surroundings || this.surroundings.hovered === shape) return;
    this.surroundings.hover(shape);
    this.dirty = true;
  }

  /** Shapes at normalised device coordinates in front of a distance, the nearest first. */
  shapesUnder(x, y, distance) {
    return this.surroundings && this.surroundingsShown ? this.surroundings.under(this.camera, x, y, distance) : [];
  }

  get size() {
    return this.body ? 2 * this.body.sphere.radius : 1;
  }

  /** Set the accent and the colours of forces of tools by index. */
  setColours(accent, dark, colours) {
    Object.assign(this, { accent, dark });
    this.surroundings?.setColours(accent, dark);
    this.arrows.forEach((arrow, index) => arrow.setColour(colours[index]));
    this.marker.material.color.set(accent);
    this.overlay?.lines.material.color.set(accent);
    this.shadow.strength = dark ? 0.6 : 0.2;
    this.dirty = true;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.resolution.ratio);
    this.renderer.setSize(width, height, false);
    this.height = height;
    this.width = width;
    this.orbitCamera.resize(width / height, height);
    this.dirty = true;
  }

  /** Normalised device coordinates (-1..1) of a pointer event. */
  deviceCoordinates(event) {
    const box = this.canvas.getBoundingClientRect();
    return [(2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height];
  }

  pick(x, y) {
    return this.body && pick(this.body, this.camera, x, y);
  }

  /** The first tool, and the arrow of its force. */
  get tool() {
    return this.tools[0];
  }

  get arrow() {
    return this.arrows[0];
  }

  /** Which of the tools of some indices is at normalised device coordinates, in front of a distance or at its own point; or -1. */
  toolUnder(x, y, indices, distance) {
    raycaster.setFromCamera(new three.Vector2(x, y), this.camera);
    const hits = indices.flatMap((index) => raycaster.intersectObject(this.tools[index].group).map((hit) => [hit.distance, index]));
    const [nearest] = hits.sort(([a], [b]) => a - b);
    if (nearest?.[0] < distance) return nearest[1];
    const [u, v] = [(0.5 + 0.5 * x) * this.width, (0.5 - 0.5 * y) * this.height];
    const away = indices.map((index) => {
      const [left, top] = this.project(this.tools[index].group.position.toArray());
      return [Math.hypot(left - u, top - v), index];
    });
    const [closest] = away.sort(([a], [b]) => a - b);
    return closest?.[0] < PICK_SLACK ? closest[1] : -1;
  }

  /** Pixel coordinates of a point in space. */
  project(point) {
    const { x, y } = new three.Vector3(...point).project(this.camera);
    return [(0.5 + 0.5 * x) * this.width, (0.5 - 0.5 * y) * this.height];
  }

  metresPerPixel(point) {
    return this.orbitCamera.metresPerPixel(this.height, point?.distanceTo(this.camera.position));
  }

  /** Direction [3] in space of a line to the right on the screen. */
  rightward() {
    return this.camera.matrixWorld.elements.slice(0, 3);
  }

  /** Render if anything has changed in the last seconds; returns whether it did. */
  draw(seconds) {
    const moved = this.orbitCamera.update(seconds);
    if (!moved && !this.dirty) return false;
    this.dirty = false;
    if (this.resolution.addFrame(seconds)) this.resize();
    if (this.body) {
      this.body.material.uniforms.viewMatrixOf.value.copy(this.camera.matrixWorldInverse);
      this.shadow.update(this.body, this.camera);
      this.body.cullBackFaces(this.camera.position);
    }
    this.renderer.render(this.graph, this.camera);
    return true;
  }
}

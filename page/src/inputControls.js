// Input controls: convert pointer, wheel, touch and keys to poses of the tool or motions of the camera.
import { Press } from "./press.js";

const CURSOR_STEP = 0.02; // of an arrow key, in normalised device coordinates
const DEPTH_STEP = 1e-3; // [m] of a key
const CLICK_SLACK = 4; // [px] that the pointer may move in a click
const CLICK_TIME = 300; // [ms] of a click on a shape in front of the body

export class InputControls {
  /**
   * `page` has tool(), driver(), requestControl(), send(message), poseSent(sequence, stamp), pressChanged(press | null),
   * missed(why, [x, y]) for a press that cannot begin, and clicked([u, v], distance, [x, y]) for a short click on the body
   * at a distance, or next to it; it returns whether a shape was there.
   */
  constructor(scene, page) {
    Object.assign(this, { scene, page, press: null, hover: null, pointers: new Map(), cameraMotion: null });
    const { canvas } = scene;
    const listen = (name, answer) => canvas.addEventListener(name, answer.bind(this), { passive: false });
    listen("pointerdown", this.down);
    listen("pointermove", this.move);
    listen("pointerrawupdate", this.moveRaw); // earlier than the next frame; only on secure origins such as this machine
    listen("pointerup", this.up);
    listen("pointercancel", this.up);
    listen("pointerleave", () => this.setHover(null));
    listen("wheel", this.wheel);
    listen("contextmenu", (event) => event.preventDefault());
    listen("dblclick", (event) => this.scene.pick(...this.scene.deviceCoordinates(event)) || this.scene.orbitCamera.reset());
  }

  down(event) {
    event.preventDefault();
    this.scene.canvas.focus({ preventScroll: true });
    this.scene.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.pointers.size > 1) return this.startPinch();
    const hit = event.button === 0 && !event.shiftKey && this.scene.pick(...this.scene.deviceCoordinates(event));
    const plain = event.button === 0 && !event.shiftKey && !event.ctrlKey;
    this.click = plain && { x: event.clientX, y: event.clientY, stamp: event.timeStamp, distance: hit ? hit.distance : Infinity };
    if (!hit) this.cameraMotion = event.button === 1 || event.ctrlKey ? "pan" : "rotate";
    else this.begin(hit, event.timeStamp);
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return event.pointerType === "touch" || this.setHover(this.scene.deviceCoordinates(event));
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    if (this.pointers.size > 1) return this.pinchMove(event);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.press) this.press.drag(dx, dy, event.timeStamp);
    else if (this.cameraMotion === "rotate") this.scene.orbitCamera.rotate(dx, dy);
    else if (this.cameraMotion === "pan") this.scene.orbitCamera.pan(dx, dy, this.scene.height);
  }

  /** Move a press at once, before the pointer event of the next frame. */
  moveRaw(event) {
    if (this.press && this.pointers.size === 1) this.move(event);
  }

  up(event) {
    this.pointers.delete(event.pointerId);
    const { click } = this;
    this.click = null;
    if (this.pointers.size === 0) this.cameraMotion = null;
    if (this.press) this.release();
    if (click && event.type === "pointerup" && Math.hypot(event.clientX - click.x, event.clientY - click.y) < CLICK_SLACK) this.answerClick(click, event);
  }

  wheel(event) {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === 1 ? 16 : 1);
    if (this.press) this.press.deepen(-2e-5 * pixels, event.timeStamp);
    else this.scene.orbitCamera.zoom(Math.exp(0.0012 * pixels));
  }

  /** Two fingers rotate and zoom; they end a press by the first one. */
  startPinch() {
    this.click = null;
    if (this.press) this.release();
    this.setHover(null);
    this.cameraMotion = null;
  }

  pinchMove(event) {
    const [first, second] = [...this.pointers.keys()];
    const other = this.pointers.get(event.pointerId === first ? second : first);
    const before = this.pointers.get(event.pointerId);
    const now = [event.clientX, event.clientY];
    const distance = ([x, y]) => Math.hypot(x - other[0], y - other[1]);
    this.scene.orbitCamera.zoom(distance(before) / Math.max(distance(now), 1));
    this.scene.orbitCamera.rotate(0.5 * (now[0] - before[0]), 0.5 * (now[1] - before[1]));
    this.pointers.set(event.pointerId, now);
  }

  /** Set the coordinates at which a preview of the tool is shown. */
  setHover(place) {
    this.hover = place;
    this.scene.dirty = true;
  }

  /** Name the shape under a click; on the body only a short click, if the shape is in front of it. */
  answerClick({ stamp, distance }, event) {
    const onBody = distance < Infinity;
    if (onBody && event.timeStamp - stamp > CLICK_TIME) return;
    const box = this.scene.canvas.getBoundingClientRect();
    const named = this.page.clicked(this.scene.deviceCoordinates(event), distance, [event.clientX - box.left, event.clientY - box.top]);
    if (!named && !onBody) this.miss(event);
  }

  /** Answer a click next to the body. */
  miss(event) {
    const kind = this.page.driver() && this.scene.body && this.page.tool()?.kind;
    if (!kind || kind === "group") return;
    const box = this.scene.canvas.getBoundingClientRect();
    this.page.missed(`nothing here to ${{ grasp: "hold", scalpel: "cut" }[kind] ?? "press"}`, [event.clientX - box.left, event.clientY - box.top]);
  }

  begin(hit, stamp) {
    if (!this.page.driver()) {
      this.page.requestControl();
      return;
    }
    const { kind, radius } = this.page.tool();
    if (kind === "grasp" && this.scene.body.isFixedNear(hit.vertex, radius)) {
      this.page.missed("fixed here", this.scene.project(hit.point.toArray()));
      return;
    }
    this.press = new Press(this.scene, this.page, hit, stamp);
    this.page.pressChanged(this.press);
  }

  release() {
    this.press = null;
    this.page.send({ type: "release" });
    this.page.pressChanged(null);
  }

  /** Arrow keys, + and -, space; returns whether the key was used. */
  key(event) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const arrow = arrows[event.key];
    if (arrow) this.step(arrow, event);
    else if (event.key === "+" || event.key === "=") this.changeDepth(DEPTH_STEP, event.timeStamp);
    else if (event.key === "-") this.changeDepth(-DEPTH_STEP, event.timeStamp);
    else if (event.key === " " && this.press) this.release();
    else return event.key === " ";
    return true;
  }

  step([x, y], event) {
    const size = event.shiftKey ? 4 : 1;
    if (this.press) this.press.slide(size * DEPTH_STEP * x, size * DEPTH_STEP * y, event.timeStamp);
    else {
      const [u, v] = this.hover ?? [0, 0];
      const next = [u + size * CURSOR_STEP * x, v + size * CURSOR_STEP * y];
      if (this.scene.pick(...next)) this.setHover(next);
      else if (!this.hover) this.setHover([0, 0]);
    }
  }

  changeDepth(metres, stamp) {
    if (!this.press && metres > 0) {
      const hit = this.scene.pick(...(this.hover ?? [0, 0]));
      if (hit) this.begin(hit, stamp);
    } else this.press?.deepen(metres, stamp);
  }

  /** Update once per frame: the press, and the preview of the tool. */
  update(seconds, state) {
    this.press?.update(seconds, state);
    const { ghost, marker, size } = this.scene;
    const hit = !this.press && this.hover && this.page.driver() && this.scene.pick(...this.hover);
    marker.mesh.visible = ghost.group.visible = false;
    if (!hit) return;
    const tool = this.page.tool();
    const radius = tool.kind === "grasp" || tool.kind === "group" ? 0.012 * size : tool.radius;
    if (tool.kind === "grasp" || tool.kind === "group") marker.at(hit.point, hit.normal, radius);
    else {
      ghost.shape(tool, size);
      const { position, quaternion } = Press.initialPose(this.scene, tool, hit);
      ghost.at(position.toArray(), quaternion);
      ghost.group.visible = true;
    }
  }
}


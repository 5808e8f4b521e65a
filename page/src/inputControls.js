// Input controls: convert pointer, wheel, touch and keys to poses of the tools or motions of the camera.
import { Press } from "./press.js";

const CURSOR_STEP = 0.02; // of an arrow key, in normalised device coordinates
const DEPTH_STEP = 1e-3; // [m] of a key
const ROLL_STEP = Math.PI / 24; // [rad] of a key
const ROLL_OF_WHEEL = 2e-3; // [rad] of a pixel
const CLICK_SLACK = 4; // [px] that the pointer may move in a click
const CLICK_TIME = 300; // [ms] of a click on a shape in front of the body

export class InputControls {
  /**
   * `page` has driver(), requestControl(), send(message), address(index) of messages, poseSent(sequence, stamp),
   * pressChanged(press | null), missed(why, [x, y]) for a press that cannot begin, and clicked([u, v], distance, [x, y]) for a
   * short click on the body at a distance, or next to it; it returns whether a shape was there. `hands` are the tools
   * of the session (`Hands`).
   */
  constructor(scene, page, hands) {
    Object.assign(this, { scene, page, hands, presses: [], hover: null, roll: 0, pointers: new Map(), cameraMotion: null });
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

  /** The press of the tool in hand, or null. */
  get press() {
    return this.presses.find(({ index }) => index === this.hands.inHand) ?? null;
  }

  pressOf(pointer) {
    return this.presses.find((press) => press.pointer === pointer) ?? null;
  }

  down(event) {
    event.preventDefault();
    const { scene, pointers } = this;
    scene.canvas.focus({ preventScroll: true });
    scene.canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const plain = event.button === 0 && !event.shiftKey;
    const place = scene.deviceCoordinates(event);
    const hit = plain && scene.pick(...place);
    if (pointers.size > 1 && !this.isSecondPress(hit, event)) return this.startPinch();
    const distance = hit ? hit.distance : Infinity;
    this.click = pointers.size === 1 && plain && !event.ctrlKey && { x: event.clientX, y: event.clientY, stamp: event.timeStamp, distance };
    const held = plain && this.page.driver() ? this.heldUnder(place, distance) : -1;
    if (held >= 0) this.grab(held, event.pointerId);
    else if (!hit) this.cameraMotion = event.button === 1 || event.ctrlKey ? "pan" : "rotate";
    else this.begin(hit, event.timeStamp, event.pointerId);
  }

  /** Whether a second finger presses, too: both are on the body. */
  isSecondPress(hit, { pointerType }) {
    return Boolean(hit) && pointerType === "touch" && this.pointers.size === 2 && this.hands.several && this.presses.some(({ pointer }) => pointer !== null);
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return event.pointerType === "touch" || this.setHover(this.scene.deviceCoordinates(event));
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    const press = this.pressOf(event.pointerId);
    if (this.pointers.size > 1 && !press) return this.pinchMove(event);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (press) press.drag(dx, dy, event.timeStamp);
    else if (this.cameraMotion === "rotate") this.scene.orbitCamera.rotate(dx, dy);
    else if (this.cameraMotion === "pan") this.scene.orbitCamera.pan(dx, dy, this.scene.height);
  }

  /** Move a press at once, before the pointer event of the next frame. */
  moveRaw(event) {
    if (this.pressOf(event.pointerId)) this.move(event);
  }

  up(event) {
    this.pointers.delete(event.pointerId);
    const { click } = this;
    this.click = null;
    if (this.pointers.size === 0) this.cameraMotion = null;
    const clicked = click && event.type === "pointerup" && Math.hypot(event.clientX - click.x, event.clientY - click.y) < CLICK_SLACK;
    const press = this.pressOf(event.pointerId);
    if (press?.taken && clicked) press.pointer = null; // a tool that was held is in hand now, where it is
    else if (press) this.letGo(press);
    if (clicked && !press?.taken) this.answerClick(click, event);
  }

  wheel(event) {
    event.preventDefault();
    const pixels = (event.deltaY || event.deltaX) * (event.deltaMode === 1 ? 16 : 1); // Shift may turn the wheel's direction
    if (event.shiftKey) this.turn(ROLL_OF_WHEEL * pixels, event.timeStamp);
    else if (this.press) this.press.deepen(-2e-5 * pixels, event.timeStamp);
    else this.scene.orbitCamera.zoom(Math.exp(0.0012 * pixels));
  }

  /** Turn the tool in hand around the normal of the surface by an angle [rad]. */
  turn(angle, stamp) {
    this.roll += angle;
    this.press?.roll(angle, stamp);
    this.scene.dirty = true;
  }

  /** Two fingers next to the body, or three, rotate and zoom; they end presses by fingers. */
  startPinch() {
    this.click = null;
    for (const press of this.presses.filter(({ pointer }) => pointer !== null)) this.letGo(press);
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
    const kind = this.page.driver() && this.scene.body && this.hands.tool?.kind;
    if (!kind || kind === "group") return;
    const box = this.scene.canvas.getBoundingClientRect();
    this.page.missed(`nothing here to ${{ grasp: "hold", scalpel: "cut" }[kind] ?? "press"}`, [event.clientX - box.left, event.clientY - box.top]);
  }

  /** Press with the tool in hand; a second finger with another one of its kind. */
  begin(hit, stamp, pointer = null) {
    if (!this.page.driver()) return this.page.requestControl();
    const refused = (why) => this.page.missed(why, this.scene.project(hit.point.toArray()));
    const second = this.presses.some((press) => press.pointer !== null);
    if (!second) this.putAside();
    const index = second ? this.hands.free(this.presses) : this.hands.inHand;
    const { tool } = this.hands;
    if (second && tool.kind === "scalpel") return refused("one blade at a time");
    if (index < 0) return refused("no tool is free");
    if (tool.kind === "grasp" && this.scene.body.isFixedNear(hit.vertex, tool.radius)) return refused("fixed here");
    if (second) this.hands.prepare(index, { ...tool });
    const press = new Press(this.scene, this.page, hit, stamp, { tool, index, roll: this.roll });
    if (pointer === null) press.stopGrowth(); // keys go deeper step by step
    this.add(press, pointer);
  }

  add(press, pointer) {
    press.pointer = pointer;
    this.presses = [...this.presses.filter(({ index }) => index !== press.index), press];
    this.page.pressChanged(press);
  }

  /** The tool that is held at normalised device coordinates, in front of a distance; or -1. */
  heldUnder(place, distance) {
    return this.scene.toolUnder(...place, this.hands.held, distance);
  }

  /** Take a tool in hand that is held. */
  grab(index, pointer = null) {
    if (!this.presses.some((press) => press.pointer !== null)) this.putAside();
    const former = this.hands.take(index);
    if (!former) return;
    const press = former instanceof Press ? former : Press.resume(this.scene, this.page, former, { tool: this.hands.tool, index });
    press.begin();
    press.stopGrowth();
    press.taken = true; // it was held, and is held again where it is let go
    this.add(press, pointer);
  }

  /** Let the tool in hand go before another is taken; hold it where it was held before. */
  putAside() {
    if (!this.press) return;
    if (this.press.taken) this.hold(this.press);
    else this.release(this.press);
  }

  /** The pointer of a press is up. */
  letGo(press) {
    if (press.leave()) press.pointer = null; // until it has touched
    else if (press.taken || (this.hands.armed && press.index === this.hands.inHand)) this.hold(press);
    else this.release(press);
  }

  /** Hold a press where it is, and take another tool in hand; without a press, the next one is held where it is let go. */
  hold(press = this.press) {
    if (!press) this.hands.arm();
    else if (this.hands.hold(press, this.presses)) {
      this.presses = this.presses.filter((each) => each !== press);
      this.page.pressChanged(null);
    } else if (press.pointer !== null && !this.pointers.has(press.pointer)) this.release(press);
  }

  release(press = this.press) {
    if (!press) return;
    this.presses = this.presses.filter((each) => each !== press);
    this.hands.release(press.index);
    this.page.pressChanged(null);
  }

  /** Forget all presses without a message. */
  forget() {
    this.presses = [];
  }

  /** Arrow keys, + and -, [ and ], space; returns whether the key was used. */
  key(event) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const arrow = arrows[event.key];
    if (arrow) this.step(arrow, event);
    else if (event.key === "+" || event.key === "=") this.changeDepth(DEPTH_STEP, event.timeStamp);
    else if (event.key === "-") this.changeDepth(-DEPTH_STEP, event.timeStamp);
    else if (event.key === "[" || event.key === "]") this.turn(event.key === "[" ? ROLL_STEP : -ROLL_STEP, event.timeStamp);
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

  /** Update once per frame: the presses, and the preview of the tool. */
  update(seconds, state) {
    for (const press of [...this.presses]) {
      press.update(seconds, state, this.hands.state(press.index));
      if (press.leaving) this.letGo(press);
    }
    const { ghost, marker, size } = this.scene;
    marker.mesh.visible = ghost.group.visible = false;
    const free = !this.press && this.hover && this.page.driver();
    const hit = free && this.scene.pick(...this.hover);
    this.overHeld = free ? this.heldUnder(this.hover, hit ? hit.distance : Infinity) : -1;
    if (!hit || this.overHeld >= 0) return;
    const { tool, inHand } = this.hands;
    const radius = tool.kind === "grasp" || tool.kind === "group" ? 0.012 * size : tool.radius;
    if (tool.kind === "grasp" || tool.kind === "group") marker.at(hit.point, hit.normal, radius);
    else {
      ghost.shape(tool, size);
      ghost.tint(inHand);
      ghost.fade(tool.kind === "scalpel" ? 1 : 0.5);
      ghost.stroke(1, 0);
      const { position, quaternion } = Press.initialPose(this.scene, tool, hit, this.roll);
      ghost.at(position.toArray(), quaternion);
      ghost.keepInView(this.scene.camera);
      ghost.group.visible = true;
    }
  }
}

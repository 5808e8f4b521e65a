// The hand: pointer, wheel, touch and keys become poses of the tool, or turns of the eye.
import { Press } from "./press.js";

const STEP = 0.02; // of the picture, that an arrow key moves the mark
const STAY = 1e-3; // [m] per notch

export class Hand {
  /** `page` has tool(), driver(), drive(), send(message), say(text), pressed(press | null). */
  constructor(stage, page) {
    Object.assign(this, { stage, page, press: null, hover: null, pointers: new Map(), turning: null });
    const { canvas } = stage;
    const listen = (name, answer) => canvas.addEventListener(name, answer.bind(this), { passive: false });
    listen("pointerdown", this.down);
    listen("pointermove", this.move);
    listen("pointerrawupdate", this.hurry); // before the next picture; where the page is served from this machine
    listen("pointerup", this.up);
    listen("pointercancel", this.up);
    listen("pointerleave", () => this.point(null));
    listen("wheel", this.wheel);
    listen("contextmenu", (event) => event.preventDefault());
    listen("dblclick", (event) => this.stage.pick(...this.stage.place(event)) || this.stage.orbit.reset());
  }

  down(event) {
    event.preventDefault();
    this.stage.canvas.focus({ preventScroll: true });
    this.stage.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.pointers.size > 1) return this.pinch();
    const hit = event.button === 0 && !event.shiftKey && this.stage.pick(...this.stage.place(event));
    if (!hit) this.turning = event.button === 1 || event.ctrlKey ? "pan" : "turn";
    else this.begin(hit, event.timeStamp);
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return event.pointerType === "touch" || this.point(this.stage.place(event));
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    if (this.pointers.size > 1) return this.spread(event);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.press) this.press.drag(dx, dy, event.timeStamp);
    else if (this.turning === "turn") this.stage.orbit.turn(dx, dy);
    else if (this.turning === "pan") this.stage.orbit.pan(dx, dy, this.stage.height);
  }

  /** A press follows the pointer at once; the event of the next picture then finds nothing new. */
  hurry(event) {
    if (this.press && this.pointers.size === 1) this.move(event);
  }

  up(event) {
    this.pointers.delete(event.pointerId);
    if (this.pointers.size === 0) this.turning = null;
    if (this.press) this.release();
  }

  wheel(event) {
    event.preventDefault();
    const turns = event.deltaY * (event.deltaMode === 1 ? 16 : 1);
    if (this.press) this.press.deepen(-2e-5 * turns, event.timeStamp);
    else this.stage.orbit.zoom(Math.exp(0.0012 * turns));
  }

  /** Two fingers: they turn, move and zoom; a press by the first ends. */
  pinch() {
    if (this.press) this.release();
    this.point(null);
    this.turning = null;
  }

  spread(event) {
    const [first, second] = [...this.pointers.keys()];
    const other = this.pointers.get(event.pointerId === first ? second : first);
    const before = this.pointers.get(event.pointerId);
    const now = [event.clientX, event.clientY];
    const apart = ([x, y]) => Math.hypot(x - other[0], y - other[1]);
    this.stage.orbit.zoom(apart(before) / Math.max(apart(now), 1));
    this.stage.orbit.turn(0.5 * (now[0] - before[0]), 0.5 * (now[1] - before[1]));
    this.pointers.set(event.pointerId, now);
  }

  /** Show where the tool would touch, under the pointer. */
  point(place) {
    this.hover = place;
    this.stage.dirty = true;
  }

  begin(hit, stamp) {
    if (!this.page.driver()) {
      this.page.drive();
      return;
    }
    this.press = new Press(this.stage, this.page, hit, stamp);
    this.page.pressed(this.press);
  }

  release() {
    this.press = null;
    this.page.send({ type: "release" });
    this.page.pressed(null);
  }

  /** Arrow keys, + and -, space; returns whether the key meant something here. */
  key(event) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const arrow = arrows[event.key];
    if (arrow) this.step(arrow, event);
    else if (event.key === "+" || event.key === "=") this.deeper(STAY, event.timeStamp);
    else if (event.key === "-") this.deeper(-STAY, event.timeStamp);
    else if (event.key === " " && this.press) this.release();
    else return event.key === " ";
    return true;
  }

  step([x, y], event) {
    const size = event.shiftKey ? 4 : 1;
    if (this.press) this.press.slide(size * STAY * x, size * STAY * y, event.timeStamp);
    else {
      const [u, v] = this.hover ?? [0, 0];
      const next = [u + size * STEP * x, v + size * STEP * y];
      if (this.stage.pick(...next)) this.point(next);
      else if (!this.hover) this.point([0, 0]);
    }
  }

  deeper(metres, stamp) {
    if (!this.press && metres > 0) {
      const hit = this.stage.pick(...(this.hover ?? [0, 0]));
      if (hit) this.begin(hit, stamp);
    } else this.press?.deepen(metres, stamp);
  }

  /** Each picture: send what is due, draw the tool and its mark where they are. */
  tick(seconds, state) {
    this.press?.tick(seconds, state);
    const { ghost, ring, size } = this.stage;
    const hit = !this.press && this.hover && this.page.driver() && this.stage.pick(...this.hover);
    ring.mesh.visible = ghost.group.visible = false;
    if (!hit) return;
    const tool = this.page.tool();
    const radius = tool.kind === "grasp" || tool.kind === "group" ? 0.012 * size : tool.radius;
    if (tool.kind === "grasp" || tool.kind === "group") ring.at(hit.point, hit.normal, radius);
    else {
      ghost.shape(tool, size);
      const { position, quaternion } = Press.rest(this.stage, tool, hit);
      ghost.at(position.toArray(), quaternion);
      ghost.group.visible = true;
    }
  }
}


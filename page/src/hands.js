// The tools of a session by index: one is in hand, others are held where they are.
import { withinEdge } from "./toolSettings.js";

const ANSWER_TIME = 1000; // [ms] after a request in which the session's word on it may be an older one
const AWAY = { kind: "none", pinned: false, force: [0, 0, 0], newtons: 0, position: [0, 0, 0], quaternion: [1, 0, 0, 0], pose: 0 };

export const NAMES = { sphere: "Sphere", capsule: "Capsule", grasp: "Forceps", scalpel: "Scalpel" };
export const nameOf = (kind) => NAMES[kind] ?? kind[0].toUpperCase() + kind.slice(1);
/** The name of a tool, as in the terminal and in reports, and its kind. */
export const titleOf = (index, kind) => `Tool ${index + 1}: ${nameOf(kind).toLowerCase()}`;

const emptySlot = () => ({ tool: null, pinned: false, asked: -Infinity, press: null, state: AWAY, sent: "" });

export class Hands {
  /**
   * `page` has send(message), driver(), place(tool) next to the body, say(text), announce(text) to screen readers, and
   * changed() after another tool is in hand.
   */
  constructor(page) {
    Object.assign(this, { page, max: 1, inHand: 0, slots: [emptySlot()], armed: false, kinds: [], devices: new Map() });
  }

  /** Begin with the tools of a hello message, by kind {kind: settings}. */
  offer({ max_tools: max = 1, tools }, settings) {
    Object.assign(this, { max, kinds: tools, settings: { ...settings, ...this.settings }, armed: false });
    const { tool } = this;
    this.slots = Array.from({ length: max }, emptySlot);
    this.inHand = 0;
    const fits = tool && (tools.length ? tools.includes(tool.kind) : tool.kind === "group");
    this.tool = fits ? tool : null;
  }

  get several() {
    return this.max > 1;
  }

  /** The settings of the tool in hand. */
  get tool() {
    return this.slots[this.inHand].tool;
  }

  set tool(tool) {
    this.slots[this.inHand].tool = tool;
  }

  /** What says in a message which tool is meant. */
  address(index) {
    return this.several ? { index } : {};
  }

  state(index) {
    return this.slots[index].state;
  }

  /** Indices of the tools that are held. */
  get held() {
    return this.slots.flatMap(({ pinned }, index) => (pinned ? [index] : []));
  }

  /** The index of the tool whose force is read: the one in hand, or where none presses the held one with the largest force. */
  get read() {
    if (this.state(this.inHand).kind !== "none") return this.inHand;
    return this.held.reduce((best, index) => (this.state(index).newtons > this.state(best).newtons ? index : best), this.inHand);
  }

  /** Indices of the tools that are in the body's space now. */
  get active() {
    return this.slots.flatMap(({ state }, index) => (state.kind === "none" ? [] : [index]));
  }

  /** The first index that is neither held nor of a press; -1 if there is none. */
  free(presses) {
    return this.slots.findIndex(({ pinned }, index) => !pinned && !presses.some((press) => press.index === index));
  }

  /** Adopt the descriptions of all tools, or of the first one; who watches shows the driver's. */
  adopt(descriptions) {
    descriptions.slice(0, this.max).forEach((given, index) => {
      const slot = this.slots[index];
      if (!given || given.kind === "none") return this.mark(slot, false);
      const mine = this.page.driver() && ((index === this.inHand && !given.pinned) || slot.press);
      if (!mine || given.kind === "group") slot.tool = { ...(slot.tool?.kind === given.kind && slot.tool), ...given };
      if (slot.tool?.kind === given.kind) slot.tool.outline = given.outline;
      this.mark(slot, Boolean(given.pinned));
    });
    this.tool ??= { ...(this.settings[this.kinds[0]] ?? descriptions[0]) };
  }

  /** Begin to drive: with the tool in hand, or another one where that is held. */
  start() {
    if (this.slots[this.inHand].pinned) this.next(this.tool.kind, []);
    else this.put(this.inHand);
  }

  /** Take the session's word on whether a tool is held, unless it may be older than the last request. */
  mark(slot, pinned) {
    if (performance.now() - slot.asked < ANSWER_TIME) return;
    if (slot.pinned && !pinned) slot.press = null;
    slot.pinned = pinned;
  }

  /** Take the states of all tools, of a frame. */
  update(states) {
    this.slots.forEach((slot, index) => {
      slot.state = states[index] ?? AWAY;
      if (this.several) this.mark(slot, slot.state.pinned && slot.state.kind !== "none");
    });
    if (!this.page.driver()) this.inHand = this.active.find((index) => !this.slots[index].pinned) ?? this.active[0] ?? 0;
  }

  /** The index of another tool that is a blade, or -1. */
  bladeElsewhere() {
    return this.slots.findIndex(({ tool, pinned }, index) => index !== this.inHand && pinned && tool?.kind === "scalpel");
  }

  /** Select a kind for the hand; returns whether that could be done. */
  choose(kind) {
    if (kind === "scalpel" && this.bladeElsewhere() >= 0) {
      this.page.say("One blade at a time: release the scalpel that is held first.");
      return false;
    }
    this.settings[this.tool.kind] = this.tool;
    this.tool = { ...this.settings[kind] };
    this.put(this.inHand);
    return true;
  }

  /** Change settings of the tool in hand. */
  change(part) {
    this.tool = withinEdge({ ...this.tool, ...part });
    this.settings[this.tool.kind] = this.tool;
    this.put(this.inHand);
  }

  /** Select another tool for an index, such as of a second finger. */
  prepare(index, tool) {
    const slot = this.slots[index];
    slot.tool = tool;
    if (slot.sent !== JSON.stringify(tool)) this.put(index);
  }

  /** Send the tool of an index: put down next to the body, then released. Forceps are sent when they grasp. */
  put(index) {
    const slot = this.slots[index];
    const { tool } = slot;
    slot.sent = JSON.stringify(tool);
    if (tool.kind !== "grasp" && tool.kind !== "group") {
      this.page.send({ ...tool, type: "tool", position: this.page.place(tool), quaternion: [1, 0, 0, 0], ...this.address(index) });
      this.page.send({ type: "release", ...this.address(index) });
    }
    this.page.changed();
  }

  /** Let the next press be held where it is let go, or not. */
  arm() {
    if (!this.several || !this.page.driver()) return;
    this.armed = !this.armed;
    this.page.changed();
  }

  /** Hold the tool of a press where it is, and take the next one in hand; returns whether that could be done. */
  hold(press, presses) {
    this.armed = false;
    if (!this.several || !this.page.driver()) return false;
    const others = presses.filter((each) => each !== press).map(({ index }) => index);
    const free = this.slots.some((slot, index) => index !== press.index && !slot.pinned && !others.includes(index));
    if (!free) {
      this.page.say(`${this.max} tools at most: release one that is held first.`, true);
      this.page.changed();
      return false;
    }
    this.pin(press.index, true);
    this.slots[press.index].press = press;
    if (press.index === this.inHand) this.next(press.tool.kind, presses);
    return true;
  }

  /** Take a free tool in hand: of a kind, or of the first one instead of a second blade. */
  next(kind, presses) {
    const index = this.free(presses);
    if (index < 0) return;
    this.inHand = index;
    const blades = kind === "scalpel" && this.bladeElsewhere() >= 0;
    this.tool = { ...(this.settings[blades ? this.kinds[0] : kind] ?? this.tool) };
    this.put(index);
  }

  pin(index, pinned) {
    Object.assign(this.slots[index], { pinned, asked: performance.now() });
    this.page.send({ type: "pin", index, pinned });
    this.page.announce(`${titleOf(index, this.slots[index].tool.kind)} ${pinned ? "held" : "in hand"}`);
    this.page.changed();
  }

  /** Take a tool in hand that is held; returns its press, or its state where this page did not press. */
  take(index) {
    const slot = this.slots[index];
    if (!slot?.pinned) return null;
    this.inHand = index;
    const { press, state } = slot;
    slot.press = null;
    this.pin(index, false);
    return press ?? state;
  }

  release(index) {
    Object.assign(this.slots[index], { pinned: false, press: null, asked: performance.now() });
    this.page.send({ type: "release", ...this.address(index) });
    this.page.changed();
  }

  /** After a reset no tool is held, and the first one is in hand. */
  reset() {
    const { tool, several } = this;
    for (const slot of this.slots) Object.assign(slot, { pinned: false, press: null, asked: performance.now() });
    this.armed = false;
    if (!several || this.inHand === 0) return;
    this.inHand = 0;
    this.tool = { ...tool };
    this.put(0);
  }
}

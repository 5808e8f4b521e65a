// The list of the tools in the panel, the labels of those that are held, and the button that holds one.
import { plainForce } from "./forceText.js";
import { titleOf } from "./hands.js";

const LABEL_GAP = 16; // [px] between a tool and its label
const [LABEL_WIDTH, LABEL_HEIGHT] = [104, 30]; // [px], kept in view

function element(tag, name, text = "") {
  const made = document.createElement(tag);
  made.className = name;
  made.textContent = text;
  return made;
}

function button(text, name, act) {
  const made = element("button", "", text);
  made.type = "button";
  made.setAttribute("aria-label", name);
  made.title = name;
  made.onclick = act;
  return made;
}

export class HandList {
  /** `actions` has hold(), take(index), and release(index). */
  constructor(byId, hands, scene, actions) {
    Object.assign(this, { hands, scene, actions, rows: [], labels: [], list: byId("hands"), room: byId("labels"), key: "" });
    this.button = byId("hold");
    this.button.onpointerdown = (event) => event.pointerType === "touch" && actions.hold(); // a second finger makes no click
    this.button.onclick = (event) => event.pointerType !== "touch" && actions.hold();
  }

  /** The tools that are listed: those in the body's space, held or in hand. */
  get listed() {
    const { hands } = this;
    return hands.slots.map((slot, index) => ({ ...slot, index, inHand: index === hands.inHand }))
      .filter(({ tool, pinned, state, inHand }) => tool && (pinned || state.kind !== "none" || inHand));
  }

  /** Show the list for who drives, or who watches. */
  show(driver) {
    const { hands, listed } = this;
    this.button.hidden = !hands.several || !driver;
    this.button.setAttribute("aria-pressed", hands.armed);
    const key = JSON.stringify([driver, hands.several, [...hands.devices], listed.map(({ index, tool, pinned, inHand }) => [index, tool.kind, pinned, inHand])]);
    if (key === this.key) return;
    this.key = key;
    this.list.hidden = !hands.several || (listed.length < 2 && !hands.devices.size);
    this.rows = listed.map((each) => this.row(each, driver));
    this.list.replaceChildren(...this.rows.map(({ row }) => row));
    const labelled = hands.several ? listed.filter(({ pinned, inHand }) => pinned || (!inHand && listed.length > 1)) : [];
    this.labels = labelled.map((each) => this.label(each, driver));
    this.room.replaceChildren(...this.labels.map(({ label }) => label));
  }

  row({ index, tool, pinned, inHand }, driver) {
    const name = titleOf(index, tool.kind);
    const row = element("li", inHand ? "in-hand" : "");
    row.dataset.index = index;
    const force = element("output", "value");
    const device = this.hands.devices.get(index);
    const where = element("span", "where", device ?? (pinned ? "held" : inHand ? "in hand" : ""));
    if (device) where.title = `Moved by the device ${device}`;
    const title = pinned && driver ? button(name, `Take ${name} in hand`, () => this.actions.take(index)) : element("span", "", name);
    title.classList.add("name");
    row.append(element("i", `chip tool-${index}`), title, where, force);
    if (driver && !device && (pinned || !inHand)) row.append(button("×", `Release ${name}`, () => this.actions.release(index)));
    return { row, force, index };
  }

  label({ index, tool }, driver) {
    const name = titleOf(index, tool.kind);
    const label = element("div", `held-label tool-${index}`);
    label.dataset.index = index;
    const force = element("span", "");
    label.append(element("i", `chip tool-${index}`), force);
    if (driver && !this.hands.devices.has(index)) {
      force.onclick = () => this.actions.take(index);
      label.append(button("×", `Release ${name}`, () => this.actions.release(index)));
    }
    return { label, force, index };
  }

  /** Write the forces; none is known beyond training. */
  update(beyond) {
    for (const { force, index } of [...this.rows, ...this.labels]) {
      const { newtons, kind } = this.hands.state(index);
      const text = kind === "none" ? "" : beyond ? "–" : `${plainForce(newtons)} N`;
      if (force.textContent !== text) force.textContent = text;
    }
  }

  /** Put the labels next to their tools. */
  place() {
    for (const { label, index } of this.labels) {
      const { kind, position } = this.hands.state(index);
      label.hidden = kind === "none";
      if (label.hidden) continue;
      const [x, y] = this.scene.project(position);
      const left = Math.max(Math.min(x + LABEL_GAP, this.scene.width - LABEL_WIDTH), 0);
      const top = Math.max(Math.min(y + LABEL_GAP, this.scene.height - LABEL_HEIGHT), 0);
      label.style.translate = `${Math.round(left)}px ${Math.round(top)}px`;
    }
  }
}

// The labels of a map, one or several of which are chosen as the body.
import { formatNumber } from "./widgets.js";

const SHORT_LIST = 12; // labels that need no search
const MAX_INNER = 6; // labels listed that lie in another one

/** Volume in millilitres as text, of one in cubic metres. */
export const millilitres = (volume) => {
  const value = 1e6 * volume;
  return value >= 100 ? String(Math.round(value)) : formatNumber(value, 2);
};

/** Whether a label has all words of a text in its name or number. */
export const matches = ({ name, number }, text) => {
  const whole = `${number} ${name} ${name.replaceAll("_", " ")}`.toLowerCase();
  return text.toLowerCase().split(/\s+/).every((word) => whole.includes(word));
};

/** What chooses the largest piece of a label. */
const largestPiece = (part) => `${part}#1`;

export class LabelChoice {
  /** `send(message)` sends the choice. */
  constructor(byId, send) {
    Object.assign(this, { byId, send, ticked: new Set(), leftOut: new Map(), rows: [] });
    byId("choice-find").oninput = () => this.filter();
    byId("choice-start").onclick = () => this.choose([...this.ticked]);
    byId("choice-piece").onclick = () => this.choose([largestPiece(this.asked[0])]);
  }

  /** Show the labels of a message. */
  show({ title, labels }) {
    const { byId } = this;
    this.ticked.clear();
    this.leftOut.clear();
    document.title = `${title} · palpate`;
    this.open(true);
    byId("choice-title").textContent = title;
    this.rows = labels.map((label) => [label, this.makeRow(label)]);
    byId("choice-rows").replaceChildren(...this.rows.map(([, row]) => row));
    byId("choice-find").value = "";
    byId("choice").classList.toggle("long", labels.length > SHORT_LIST);
    this.filter();
    this.wait(false);
    byId("choice-rows").querySelector("button")?.focus();
  }

  makeRow(label) {
    const { part, name, number, volume, pieces, at_edge: cut } = label;
    const row = document.createElement("tr");
    row.innerHTML = `<td><input type="checkbox" /></td><th scope="row"><button type="button"></button></th><td></td><td></td><td></td><td></td>`;
    const [tick, , ...cells] = row.children;
    const box = tick.firstChild;
    box.setAttribute("aria-label", `Add ${name}`);
    box.onchange = () => this.tick(part, box.checked);
    const button = row.querySelector("button");
    button.textContent = name;
    const inner = this.makeInner(label);
    button.after(inner);
    [number, millilitres(volume), pieces, cut ? "yes" : ""].forEach((text, k) => (cells[k].textContent = text));
    row.onclick = ({ target }) => {
      if (inner.contains(target)) return;
      if (tick.contains(target)) {
        if (target !== box) box.click();
      } else this.choose([part]);
    };
    return row;
  }

  /** Lines about what lies in a label: what joins it can be left out, the rest is named. */
  makeInner({ part, inner = [] }) {
    const lines = document.createElement("div");
    lines.className = "inner";
    const left = new Set();
    this.leftOut.set(part, left);
    const joiningFirst = inner.toSorted((one, other) => other.joins - one.joins);
    for (const each of joiningFirst.slice(0, MAX_INNER)) {
      const line = document.createElement(each.joins ? "label" : "p");
      if (each.joins) {
        const box = document.createElement("input");
        Object.assign(box, { type: "checkbox", checked: true });
        box.onchange = () => (box.checked ? left.delete(each.part) : left.add(each.part));
        line.append(box);
      }
      const name = document.createElement("b");
      name.textContent = `${each.joins ? "with" : "without"} ${each.name}`;
      line.append(name, ` (${each.why})`);
      lines.append(line);
    }
    if (inner.length > MAX_INNER) lines.append(`and ${inner.length - MAX_INNER} more`);
    return lines;
  }

  tick(part, on) {
    if (on) this.ticked.add(part);
    else this.ticked.delete(part);
    this.update();
  }

  filter() {
    const text = this.byId("choice-find").value.trim();
    for (const [label, row] of this.rows) row.hidden = !matches(label, text);
    this.byId("choice-none").hidden = this.rows.some(([, row]) => !row.hidden);
  }

  update() {
    const start = this.byId("choice-start");
    const count = this.ticked.size;
    start.disabled = count === 0 || this.waiting;
    start.textContent = count > 1 ? `Start with ${count} labels` : "Start with the ticked label";
  }

  choose(parts) {
    if (this.waiting || parts.length === 0) return;
    this.asked = parts;
    const without = parts.flatMap((part) => [...(this.leftOut.get(part) ?? [])]).filter((part) => !parts.includes(part));
    this.send({ type: "choose", parts, without });
    this.wait(true);
  }

  /** Wait for an answer, or for a choice. */
  wait(waiting) {
    this.waiting = waiting;
    this.byId("choice").classList.toggle("waiting", waiting);
    if (waiting) this.byId("choice-error").textContent = "";
    if (waiting) this.byId("choice-piece").hidden = true;
    this.update();
  }

  /** Show why a choice makes no body. */
  fail(reason) {
    if (this.byId("choice").hidden) return false;
    this.wait(false);
    this.byId("choice-error").textContent = reason;
    const [part, other] = this.asked ?? [];
    const label = this.rows.map(([each]) => each).find((each) => each.part === part);
    this.byId("choice-piece").hidden = other !== undefined || !(label?.pieces > 1);
    return true;
  }

  /** The body is being prepared. */
  end() {
    this.open(false);
  }

  open(open) {
    this.byId("choice").hidden = !open;
    for (const id of ["scene", "panel"]) this.byId(id).inert = open;
  }
}

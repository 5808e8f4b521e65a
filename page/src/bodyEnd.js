// The end of a body that forceps pull: how far it is moved, with which force, and a sentence that says what to do.
import { lawName } from "./bodyMenu.js";
import { plainForce } from "./forceText.js";

/** What to do on the page of a body with an end, by its title; of two bodies, which one is solid and which one lines. */
export function taskText(title, held, bodies = null) {
  const body = `the ${/^\p{Lu}\p{Ll}/u.test(title) ? title[0].toLowerCase() : title[0]}${title.slice(1)}`;
  if (!held) return `Pull the end of ${body}: hold the button on its free end and drag.`;
  const shown = bodies ? ` Solid: ${bodies[0]}; lines: ${bodies[1]}.` : "";
  return `Pull the end of ${body}: forceps hold it, drag anywhere.${shown}`;
}

/** The mean displacement [m] of some vertices, and where they are [m] in the mean. */
export function endMotion(vertices, { positions, rest }) {
  const mean = (values) => [0, 1, 2].map((k) => vertices.reduce((sum, vertex) => sum + values[3 * vertex + k], 0) / vertices.length);
  const [now, before] = [mean(positions), mean(rest)];
  return { moved: Math.hypot(...now.map((part, k) => part - before[k])), place: now };
}

/** The force [N] of several tools together. */
export function forceOf(tools) {
  return Math.hypot(...[0, 1, 2].map((k) => tools.reduce((sum, { force }) => sum + force[k], 0)));
}

export class BodyEnd {
  constructor(byId) {
    Object.assign(this, { byId, vertices: null, tools: [], moved: 0 });
  }

  /** Begin with the body of a hello message. */
  offer({ end = null, title, tools, mode, full, compare, compared }) {
    this.vertices = mode === "replay" ? null : end;
    this.byId("task").hidden = this.byId("end").hidden = !this.vertices;
    if (this.vertices) this.byId("task").textContent = taskText(title, tools.length === 0, compare ? (full ? compared.map(lawName) : ["the reduced model", "the full one"]) : null);
  }

  /** Take the indices of the tools that hold the end, of a status message. */
  status({ end_tools: tools = [] }) {
    this.tools = tools;
  }

  /** Whether the tool of an index holds the end. */
  holds(index) {
    return this.vertices !== null && this.tools.includes(index);
  }

  /** Take the positions of a body that was updated. */
  update(body) {
    if (this.vertices) this.moved = endMotion(this.vertices, body).moved;
  }

  /** Write the readings, by the states of all tools; the force is not known beyond training. */
  show(states, known) {
    if (!this.vertices) return;
    const newtons = forceOf(this.tools.map((index) => states[index]).filter(Boolean));
    const texts = { "end-moved": (1e3 * this.moved).toFixed(1), "end-force": known ? plainForce(newtons) : "–" };
    for (const [id, text] of Object.entries(texts)) if (this.byId(id).textContent !== text) this.byId(id).textContent = text;
  }
}

// The panel: readings of the session, and settings.
import { lawName } from "./bodyMenu.js";
import { nameOf } from "./hands.js";
import { choice, slider, formatNumber } from "./widgets.js";
import { comparisonText, cutText, forceReading, isBeyond, pressReading, trustText } from "./forceText.js";

const MIN_STIFFNESS_EXPONENT = 1.5; // power of ten of the coupling [N/m]
const REVEAL_GAP = 12; // [px] above what is opened
const RIGID_EXPONENT = 4; // the end of the slider stands for a rigid coupling

const capital = (name) => name[0].toUpperCase() + name.slice(1);

export class Panel {
  /** `actions` has send(message), choose(kind), change(fields of the tool), scalar(name). */
  constructor(byId, actions) {
    Object.assign(this, { byId, actions });
    byId("details").ontoggle = () => byId("details").open && this.reveal(byId("details"));
    byId("fast").onchange = ({ target }) => actions.send({ type: "follow", fast: target.checked });
    this.sliders = {};
  }

  /** Build the panel for a hello message. */
  offer(hello, size) {
    const { byId, actions } = this;
    this.toolParameters = hello.tool_parameters ?? {};
    byId("tools").hidden = hello.tools.length === 0;
    this.markKind = choice(byId("kinds"), hello.tools.map((kind) => [kind, nameOf(kind)]), actions.choose);
    const scalars = [["none", "Off"], ...hello.scalars.map(({ name }) => [name, capital(name)])];
    this.markScalar = choice(byId("scalars"), scalars, actions.scalar);
    byId("scalars").classList.toggle("four", scalars.length > 3);
    byId("overlay-row").hidden = !hello.overlay;
    byId("follow").hidden = (hello.tool_speed ?? null) === null; // no model that its training slows
    this.offerSizes(size, 1e3 * (hello.least_radius ?? 0));
    this.offerMaterials(hello.materials ?? []);
    this.trainingErrors = hello.training_errors;
    this.nodesError = hello.nodes_error;
    this.full = Boolean(hello.full);
    this.compare = Boolean(hello.compare);
    this.compared = this.full ? hello.compared?.map(lawName) : undefined; // names of two laws
    byId("overlay-name").textContent = this.compared?.[1] ?? "Full model";
    this.bound = undefined; // error bound of the force [N], null where it is not known
    this.beyond = this.through = false;
    this.readings = {};
  }

  /** Sliders for a body of a size [m], which takes no tool with a radius [mm] below the least. */
  offerSizes(size, leastRadius) {
    const millimetres = (share, least) => Math.max(Math.round(1e3 * share * size), least);
    const length = (value) => `${formatNumber(value)} mm`;
    const metres = (name) => ({
      text: length,
      step: 0.5,
      settled: (value) => this.actions.change({ [name]: value / 1e3 }),
    });
    const limits = { depth: [1, millimetres(0.2, 10)], radius: [Math.max(millimetres(0.012, 1), Math.ceil(2 * leastRadius) / 2), Math.max(millimetres(0.12, 4), 2 * leastRadius)] };
    const own = ({ name, unit, low, high, usual }) => {
      const title = capital(name.replaceAll("_", " "));
      if (unit !== "m") {
        const end = Math.min(high, 20 * usual || high);
        const text = (value) => `${formatNumber(value)} ${unit.replace("^2", "²")}`;
        return slider({ name: title, low, high: end, step: (end - low) / 400, value: 0, text, settled: (value) => this.actions.change({ [name]: value }) });
      }
      const [least, most] = limits[name] ?? [millimetres(0.03, 2), millimetres(0.4, 20)];
      return slider({ name: title, low: least, high: most, value: 0, ...metres(name) });
    };
    this.sliders = {};
    for (const parameter of Object.values(this.toolParameters).flat()) this.sliders[parameter.name] ??= own(parameter);
    this.byId("sizes").replaceChildren(...Object.values(this.sliders).map(({ label }) => label));
    this.coupling = slider({
      name: "Coupling stiffness", low: MIN_STIFFNESS_EXPONENT, high: RIGID_EXPONENT, step: 0.01, value: RIGID_EXPONENT,
      text: (power) => (power >= RIGID_EXPONENT ? "rigid" : `${formatNumber(10 ** power, 2)} N/m`),
      settled: (power) => this.actions.change({ stiffness: power >= RIGID_EXPONENT ? null : Number((10 ** power).toPrecision(2)) }),
    });
    this.byId("coupling").replaceChildren(this.coupling.label);
  }

  offerMaterials(materials) {
    const live = materials.filter((material) => material.live);
    this.byId("materials").hidden = live.length === 0;
    const made = live.map(({ name, unit, value, low, high }) =>
      slider({
        name: capital(name), low, high, step: (high - low) / 1000, value, text: (x) => `${formatNumber(x)} ${unit}`,
        settled: (x) => this.actions.send({ type: "material", name, value: Number(x.toPrecision(3)) }),
      }),
    );
    this.byId("material-sliders").replaceChildren(...made.map(({ label }) => label));
    this.materialSliders = made;
    this.materialNames = live.map(({ name }) => name);
  }

  /** Show the present values of the materials. */
  materials(materials) {
    for (const { name, value } of materials ?? []) this.materialSliders[this.materialNames.indexOf(name)]?.set(value);
  }

  /** Show the tool, and enable the settings for the driver. */
  status({ tool, driver, fast }, replay) {
    if (tool && this.coupling) {
      this.markKind(tool.kind);
      const names = (this.toolParameters[tool.kind] ?? []).map(({ name }) => name);
      for (const [name, { label, set }] of Object.entries(this.sliders)) {
        label.hidden = !names.includes(name);
        if (names.includes(name) && name in tool) set(this.isLength(name) ? 1e3 * tool[name] : tool[name]);
      }
      this.byId("sizes").classList.toggle("two", names.length > 1 && names.every((name) => this.isLength(name)));
      this.coupling.set(tool.stiffness ? Math.log10(tool.stiffness) : RIGID_EXPONENT);
    }
    const mine = driver && !replay;
    const own = [...Object.values(this.sliders), ...(this.coupling ? [this.coupling] : []), ...(this.materialSliders ?? [])].map(({ input }) => input);
    for (const input of [...own, ...this.byId("kinds").children]) input.disabled = !mine;
    Object.assign(this.byId("fast"), { checked: Boolean(fast), disabled: !mine });
    this.byId("tools").hidden ||= replay;
    this.byId("materials").hidden ||= replay;
    this.byId("coupling").hidden = this.byId("tools").hidden || this.compare;
  }

  isLength(name) {
    return Object.values(this.toolParameters).flat().some((each) => each.name === name && each.unit === "m");
  }

  scalar(name) {
    this.markScalar(name);
  }

  /** Take the error indicator of a state; returns whether the state is beyond training. */
  judge({ trust }) {
    this.beyond = Boolean(this.trainingErrors) && isBeyond(trust, this.beyond, this.trainingErrors.largest_trust);
    return this.beyond;
  }

  /** The force of a state in words; see `forceReading`. The force of a full model next to it shows an error that was not measured. */
  force({ newtons }) {
    const { bound, full, beyond, through, nodesError, compare } = this;
    if (compare && !this.trainingErrors) return forceReading({ newtons, calibrated: true, nodesError });
    return forceReading({ newtons, bound, full, beyond, through, nodesError, calibrated: Boolean(this.trainingErrors) });
  }

  /** Scroll what was opened into view. */
  reveal(element) {
    const still = matchMedia("(prefers-reduced-motion)").matches;
    const panel = this.byId("panel");
    const way = element.getBoundingClientRect().top - panel.getBoundingClientRect().top - REVEAL_GAP;
    panel.scrollBy({ top: way, behavior: still ? "instant" : "smooth" });
  }

  /**
   * Show the depth [m] of the press in hand, null without one, or the name of the held tool whose force is shown. The
   * displacement of an end that is pulled has its own place.
   */
  press(depth, newtons, name, ofEnd = false) {
    const reading = pressReading(depth, newtons, !this.beyond && !this.through);
    this.write("depth", reading.depth);
    this.write("stiffness", reading.stiffness);
    this.write("held-name", name);
    this.byId("depth-part").hidden = !reading.depth || ofEnd;
    this.byId("stiffness-part").hidden = !reading.stiffness;
  }

  /** Show the readings of a state, with the force [N] of the full model if it is compared. */
  state(state, fullNewtons) {
    const { lead, value, range, note } = this.force(state);
    this.write("force-lead", lead);
    this.write("force", value);
    this.write("force-range", range && `(${range})`);
    this.write("force-note", note);
    this.write("force-comparison", Number.isFinite(fullNewtons) ? comparisonText(state.newtons, fullNewtons, this.compared) : "");
    this.byId("force-section").classList.toggle("beyond", this.beyond || this.through);
    this.write("energy", (1e3 * (state.strain + state.kinetic)).toFixed(2));
    this.write("step", (1e3 * state.computing).toFixed(2));
    this.trust(state.trust);
  }

  trust(trust) {
    const known = Number.isFinite(trust) && this.trainingErrors;
    this.byId("trust").hidden = this.full;
    const { text, note } = trustText({ trust, beyond: this.beyond, bound: this.bound });
    this.write("trust-text", known ? text : "Trust not calibrated");
    this.write("trust-number", known ? trust.toFixed(2) : "");
    this.write("trust-note", known ? note || this.meanError() : "Errors on held-out runs were not measured.");
    const { classList } = this.byId("trust");
    classList.toggle("beyond", this.beyond);
    classList.toggle("none", !known);
    if (known) this.byId("trust-mark").style.left = `${(100 * Math.min(trust, 2)) / 2}%`;
  }

  meanError() {
    const error = this.trainingErrors.force_error;
    return error ? `Mean force error on held-out runs: ${formatNumber(100 * error, 2)} %` : "";
  }

  statistics({ median_ms: median, p99_ms: late, misses, periods, force_bound: bound, step_share: step, repeated, held, ...cut }) {
    this.bound = bound;
    this.write("cut", cutText(cut));
    const parts = [`Median ${median.toFixed(2)} ms`, `99 % ${late.toFixed(2)} ms`];
    // a full body may be late by some periods: its pace counts
    if (!this.full) parts.push(misses ? `${formatNumber((100 * misses) / periods, 2)} % of the periods missed` : "none missed");
    if (step < 0.98) parts.push(`steps ${Math.round(100 * step)} % of those at rest`);
    if (repeated) parts.push(`${repeated} periods repeated with shorter steps`);
    if (held) parts.push(`tool held in ${held}`);
    this.write("rate", parts.join(", "));
  }

  write(id, text) {
    if (this.readings[id] === text) return;
    this.readings[id] = text;
    this.byId(id).textContent = text;
  }
}

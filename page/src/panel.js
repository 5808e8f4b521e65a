// The panel: readings of the session, and settings.
import { choice, slider, formatNumber } from "./widgets.js";

const NAMES = { sphere: "Sphere", capsule: "Capsule", grasp: "Forceps" };
const MIN_STIFFNESS_EXPONENT = 1.5; // power of ten of the coupling [N/m]
const RIGID_EXPONENT = 4; // the end of the slider stands for a rigid coupling

const capital = (name) => name[0].toUpperCase() + name.slice(1);

export class Panel {
  /** `actions` has send(message), choose(kind), change(fields of the tool), scalar(name). */
  constructor(byId, actions) {
    Object.assign(this, { byId, actions });
    this.sliders = {};
  }

  /** Build the panel for a hello message. */
  offer(hello, size) {
    const { byId, actions } = this;
    byId("tools").hidden = hello.tools.length === 0;
    this.markKind = choice(byId("kinds"), hello.tools.map((kind) => [kind, NAMES[kind] ?? capital(kind)]), actions.choose);
    const scalars = [["none", "Off"], ...hello.scalars.map(({ name }) => [name, capital(name)])];
    this.markScalar = choice(byId("scalars"), scalars, actions.scalar);
    byId("scalars").classList.toggle("four", scalars.length > 3);
    byId("overlay-row").hidden = !hello.overlay;
    this.offerSizes(size);
    this.offerMaterials(hello.materials ?? []);
    this.trainingErrors = hello.training_errors;
    this.full = hello.full;
    this.readings = {};
  }

  offerSizes(size) {
    const millimetres = (share, least) => Math.max(Math.round(1e3 * share * size), least);
    const length = (value) => `${formatNumber(value)} mm`;
    const metres = (name) => ({
      text: length,
      step: 0.5,
      settled: (value) => this.actions.change({ [name]: value / 1e3 }),
    });
    this.sliders = {
      radius: slider({ name: "Radius", low: millimetres(0.012, 1), high: millimetres(0.12, 4), value: 0, ...metres("radius") }),
      length: slider({ name: "Length", low: millimetres(0.03, 2), high: millimetres(0.4, 20), value: 0, ...metres("length") }),
      stiffness: slider({
        name: "Coupling stiffness", low: MIN_STIFFNESS_EXPONENT, high: RIGID_EXPONENT, step: 0.01, value: RIGID_EXPONENT,
        text: (power) => (power >= RIGID_EXPONENT ? "rigid" : `${formatNumber(10 ** power, 2)} N/m`),
        settled: (power) => this.actions.change({ stiffness: power >= RIGID_EXPONENT ? null : Number((10 ** power).toPrecision(2)) }),
      }),
    };
    this.byId("sizes").replaceChildren(...Object.values(this.sliders).map(({ label }) => label));
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
  status({ tool, driver }, replay) {
    if (tool && this.sliders.radius) {
      this.markKind(tool.kind);
      this.sliders.length.label.hidden = tool.kind !== "capsule";
      this.byId("sizes").classList.toggle("two", tool.kind === "capsule");
      this.sliders.radius.set(1e3 * tool.radius);
      if (tool.length) this.sliders.length.set(1e3 * tool.length);
      this.sliders.stiffness.set(tool.stiffness ? Math.log10(tool.stiffness) : RIGID_EXPONENT);
    }
    const mine = driver && !replay;
    const own = [...Object.values(this.sliders), ...(this.materialSliders ?? [])].map(({ input }) => input);
    for (const input of [...own, ...this.byId("kinds").children]) input.disabled = !mine;
    this.byId("tools").hidden ||= replay;
    this.byId("materials").hidden ||= replay;
  }

  scalar(name) {
    this.markScalar(name);
  }

  /** Show the readings of a state. */
  state({ newtons, trust, strain, kinetic, computing }) {
    this.write("force", newtons < 99.95 ? newtons.toFixed(2) : newtons.toFixed(0));
    this.write("energy", (1e3 * (strain + kinetic)).toFixed(2));
    this.write("step", (1e3 * computing).toFixed(2));
    this.trust(trust);
  }

  trust(trust) {
    const known = Number.isFinite(trust) && this.trainingErrors;
    const beyond = known && trust > 1;
    this.write("trust-text", this.full ? "Full body" : !known ? "Trust not calibrated" : beyond ? "Outside training: force uncertain" : "Within training");
    this.write("trust-number", known ? trust.toFixed(2) : "");
    this.write("trust-note", this.trustNote(known, beyond));
    const { classList } = this.byId("trust");
    classList.toggle("beyond", beyond);
    classList.toggle("none", !known);
    if (known) this.byId("trust-mark").style.left = `${(100 * Math.min(trust, 2)) / 2}%`;
  }

  trustNote(known, beyond) {
    if (this.full) return "The body itself is stepped. No model is reduced, so there is no error of a reduction.";
    if (!known) return "Errors on held-out runs were not measured.";
    if (beyond) return "The model was not trained on such a state.";
    const error = this.trainingErrors.force_error;
    return error ? `Mean force error on held-out runs: ${formatNumber(100 * error, 2)} %` : "";
  }

  boundText(bound) {
    if (bound === undefined) return ""; // a replay
    return bound === null ? "± unknown" : `± ${formatNumber(bound, 2)} N`;
  }

  statistics({ median_ms: median, p99_ms: late, misses, periods, pace, force_bound: bound }) {
    const share = periods ? (100 * misses) / periods : 0;
    const missed = misses ? `${formatNumber(share, 2)} % missed` : "none missed";
    this.write("force-bound", this.trainingErrors ? this.boundText(bound) : "");
    const slow = pace < 0.98 ? `. Time runs at ${formatNumber(pace, 2)} of real time` : "";
    this.write("rate", `Median ${median.toFixed(2)} ms, 99 % ${late.toFixed(2)} ms, ${missed}${slow}`);
  }

  write(id, text) {
    if (this.readings[id] === text) return;
    this.readings[id] = text;
    this.byId(id).textContent = text;
  }
}

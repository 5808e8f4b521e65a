// The panel: what the session says, and what a person can change.
import { choice, slider, written } from "./controls.js";

const NAMES = { sphere: "Sphere", capsule: "Capsule", grasp: "Forceps" };
const SOFTEST = 1.5; // of the coupling, as a power of ten [N/m]
const RIGID = 4; // at this end the coupling is rigid

const capital = (name) => name[0].toUpperCase() + name.slice(1);

export class Panel {
  /** `act` has send(message), choose(kind), change(part of the tool), scalar(name). */
  constructor(byId, act) {
    Object.assign(this, { byId, act });
    this.sliders = {};
  }

  /** Lay out what a hello offers. */
  offer(hello, size) {
    const { byId, act } = this;
    byId("tools").hidden = hello.tools.length === 0;
    this.markKind = choice(byId("kinds"), hello.tools.map((kind) => [kind, NAMES[kind] ?? capital(kind)]), act.choose);
    const scalars = [["none", "Off"], ...hello.scalars.map(({ name }) => [name, capital(name)])];
    this.markScalar = choice(byId("scalars"), scalars, act.scalar);
    byId("scalars").classList.toggle("four", scalars.length > 3);
    byId("overlay-row").hidden = !hello.overlay;
    this.offerSizes(size);
    this.offerMaterials(hello.materials ?? []);
    this.trained = hello.trained;
    this.readings = {};
  }

  offerSizes(size) {
    const millimetres = (share, least) => Math.max(Math.round(1e3 * share * size), least);
    const length = (value) => `${written(value)} mm`;
    const metres = (name) => ({
      text: length,
      step: 0.5,
      settled: (value) => this.act.change({ [name]: value / 1e3 }),
    });
    this.sliders = {
      radius: slider({ name: "Radius", low: millimetres(0.012, 1), high: millimetres(0.12, 4), value: 0, ...metres("radius") }),
      length: slider({ name: "Length", low: millimetres(0.03, 2), high: millimetres(0.4, 20), value: 0, ...metres("length") }),
      stiffness: slider({
        name: "Coupling to the hand", low: SOFTEST, high: RIGID, step: 0.01, value: RIGID,
        text: (power) => (power >= RIGID ? "rigid" : `${written(10 ** power, 2)} N/m`),
        settled: (power) => this.act.change({ stiffness: power >= RIGID ? null : Number((10 ** power).toPrecision(2)) }),
      }),
    };
    this.byId("sizes").replaceChildren(...Object.values(this.sliders).map(({ label }) => label));
  }

  offerMaterials(materials) {
    const live = materials.filter((material) => material.live);
    this.byId("materials").hidden = live.length === 0;
    const made = live.map(({ name, unit, value, low, high }) =>
      slider({
        name: capital(name), low, high, step: (high - low) / 1000, value, text: (x) => `${written(x)} ${unit}`,
        settled: (x) => this.act.send({ type: "material", name, value: Number(x.toPrecision(3)) }),
      }),
    );
    this.byId("material-sliders").replaceChildren(...made.map(({ label }) => label));
    this.materialSliders = made;
    this.materialNames = live.map(({ name }) => name);
  }

  /** Show the values that materials have now. */
  materials(materials) {
    for (const { name, value } of materials ?? []) this.materialSliders[this.materialNames.indexOf(name)]?.set(value);
  }

  /** Show the tool, and whether this viewer may change it. */
  status({ tool, driver }, replay) {
    if (tool && this.sliders.radius) {
      this.markKind(tool.kind);
      this.sliders.length.label.hidden = tool.kind !== "capsule";
      this.byId("sizes").classList.toggle("two", tool.kind === "capsule");
      this.sliders.radius.set(1e3 * tool.radius);
      if (tool.length) this.sliders.length.set(1e3 * tool.length);
      this.sliders.stiffness.set(tool.stiffness ? Math.log10(tool.stiffness) : RIGID);
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

  /** Show the numbers of a state. */
  state({ newtons, trust, strain, kinetic, computing }) {
    this.write("force", newtons < 99.95 ? newtons.toFixed(2) : newtons.toFixed(0));
    this.write("energy", (1e3 * (strain + kinetic)).toFixed(2));
    this.write("step", (1e3 * computing).toFixed(2));
    this.trust(trust);
  }

  trust(trust) {
    const known = Number.isFinite(trust) && this.trained;
    const beyond = known && trust > 1;
    this.write("trust-text", !known ? "Not a trained model" : beyond ? "Beyond training: force uncertain" : "Within training");
    this.write("trust-number", known ? trust.toFixed(2) : "");
    this.write("trust-note", this.trustNote(known, beyond));
    const { classList } = this.byId("trust");
    classList.toggle("beyond", beyond);
    classList.toggle("none", !known);
    if (known) this.byId("trust-mark").style.left = `${(100 * Math.min(trust, 2)) / 2}%`;
  }

  trustNote(known, beyond) {
    if (!known) return "Its forces are those of the model itself.";
    if (beyond) return "The model never saw such a state.";
    const error = this.trained.force_error;
    return error ? `In tests its forces were ${written(100 * error, 2)} % off on average.` : "";
  }

  statistics({ median_ms: median, p99_ms: late, misses, periods }) {
    const share = periods ? (100 * misses) / periods : 0;
    const missed = misses ? `${written(share, 2)} % late` : "none late";
    this.write("rate", `Median ${median.toFixed(2)} ms, 99 % ${late.toFixed(2)} ms, ${missed}`);
  }

  write(id, text) {
    if (this.readings[id] === text) return;
    this.readings[id] = text;
    this.byId(id).textContent = text;
  }
}

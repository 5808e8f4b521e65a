// The menu of the body: the law of its tissue, and a reduced model that is shown with the full body.
import { duration, sentence } from "./preparation.js";
import { choice } from "./widgets.js";

const NAMES = {
  NeoHookean: "Neo-Hookean", MooneyRivlin: "Mooney–Rivlin", ArrudaBoyce: "Arruda–Boyce",
  StVenantKirchhoff: "St. Venant–Kirchhoff", LinearElastic: "Linear elastic",
};
export const lawName = (name) => NAMES[name] ?? name;
const TRAINING = "Runs of the full body train these models, once for each law: about half a minute, and longer the first time on a computer.";

/** The text under the menu, and the share of the bar: null for one without end, undefined for none. */
export function menuProgress({ state, phase, fraction, seconds_left: left, note }) {
  if (state === "failed") return { text: `This body could not be made: ${note}`, bad: true };
  if (state !== "preparing") return { text: note };
  const time = left === null ? " …" : `: about ${duration(left)} left`;
  return { text: `${sentence(phase || "starting")}${time} The present body stays until then.`, share: fraction };
}

export class BodyMenu {
  constructor(byId, send) {
    Object.assign(this, { byId, send, message: null, mine: false });
    byId("law").onchange = ({ target }) => this.ask({ law: target.value });
    byId("second").onchange = ({ target }) => this.ask({ second: target.value, modes: 0 });
  }

  /** Hide the menu until the session says what it has. */
  offer() {
    this.byId("body-menu").hidden = this.byId("modes-part").hidden = true;
  }

  ask(part) {
    const { law, second, shown_modes: modes } = this.message;
    if (part.modes !== undefined) this.markModes(String(part.modes));
    const asked = { law, modes, second, ...part };
    if (asked.second === asked.law) asked.second = ""; // a law is not compared with itself
    this.send({ type: "body", ...asked });
  }

  /** Show a message `bodies`. */
  show(message) {
    const { byId } = this;
    const before = this.message;
    this.message = message;
    const { laws, law, modes, trained } = message;
    if (JSON.stringify([before?.laws, before?.modes]) !== JSON.stringify([laws, modes])) this.build(message);
    byId("body-menu").hidden = false;
    byId("modes-part").hidden = modes.length === 0;
    if (message.state !== "preparing") {
      Object.assign(byId("law"), { value: law }); // else the choice stays
      Object.assign(byId("second"), { value: message.second });
      this.markModes?.(String(message.shown_modes));
    }
    for (const option of byId("second").options) option.disabled = option.value === byId("law").value;
    byId("law-text").textContent = laws.find(({ name }) => name === byId("law").value)?.text ?? "";
    byId("modes-text").textContent = trained ? "" : TRAINING;
    const { text, share, bad } = menuProgress(message);
    byId("body-text").textContent = text;
    byId("body-text").classList.toggle("bad", Boolean(bad));
    const bar = byId("body-bar");
    bar.hidden = share === undefined;
    bar.classList.toggle("open-ended", share === null);
    bar.style.setProperty("--share", `${100 * (share ?? 0)}%`);
    this.enable();
  }

  build({ laws, modes }) {
    const { byId } = this;
    byId("law").replaceChildren(...laws.map(({ name }, k) => new Option(k ? lawName(name) : `${lawName(name)} (as opened)`, name)));
    byId("second").replaceChildren(new Option("None", ""), ...laws.map(({ name }) => new Option(lawName(name), name)));
    const items = modes.map((count) => [String(count), count ? String(count) : "None"]);
    this.markModes = modes.length ? choice(byId("modes"), items, (value) => this.ask({ modes: Number(value), second: "" })) : null;
  }

  /** Enable the menu for the driver. */
  status(driver) {
    this.mine = driver;
    this.enable();
  }

  enable() {
    const idle = this.mine && this.message?.state !== "preparing";
    for (const input of [this.byId("law"), this.byId("second"), ...this.byId("modes").children]) input.disabled = !idle;
  }
}

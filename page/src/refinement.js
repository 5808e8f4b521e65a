// Training of a finer model behind the full body: progress, errors in words, and buttons.
import { duration, sentence } from "./preparation.js";

const percent = (error) => (error < 0.01 ? "less than 1\u00a0%" : `${Math.round(100 * error)}\u00a0%`);

/** The errors of a model on paths that it was not trained on. */
export function errorsText(errors) {
  const parts = Object.entries(errors ?? {}).map(([name, error], k) => `the ${name} ${k ? "" : "errs "}by ${percent(error)}`);
  return parts.length ? `On paths that it was not trained on, ${parts.join(" and ")} in the mean.` : "Its errors were not measured.";
}

/** The text, the buttons as [action, name], and the bar of a message: a share, null for one without end, or undefined for none. */
export function refinementView({ state, phase, fraction, seconds_left: left, errors, good, note }) {
  if (state === "training") {
    const time = left === null ? " …" : `: about ${duration(left)} left`;
    return { text: sentence(phase) + time, buttons: [["stop", "Stop"]], share: fraction };
  }
  const offer = "Trains a reduced model in the background, in some minutes. The session goes on.";
  if (state === "failed") return { text: sentence(note), bad: true, buttons: [["start", "Try again"]] };
  if (state === "offered") return { text: note || offer, buttons: [["start", "Refine"]] };
  if (state === "used") return { text: `In use. ${errorsText(errors)}`, buttons: [] };
  const next = good ? "It takes over when you let go." : "The full body stays until you change over.";
  return { text: `Ready. ${errorsText(errors)} ${next}`, buttons: [["use", good ? "Use it now" : "Use it anyway"]] };
}

export class Refinement {
  constructor(byId, send) {
    Object.assign(this, { byId, send, message: null, mine: false, buttons: [], shown: "" });
  }

  /** Hide the section until the session says that there is something to refine. */
  offer() {
    this.byId("refinement").hidden = true;
  }

  /** Show a message `refinement`; returns whether the model has come into use by it. */
  show(message) {
    const before = this.message?.state;
    this.message = message;
    const { byId } = this;
    const { text, buttons, share, bad } = refinementView(message);
    byId("refinement").hidden = false;
    byId("refinement-text").textContent = text;
    byId("refinement-text").classList.toggle("bad", Boolean(bad));
    const bar = byId("refinement-bar");
    bar.hidden = share === undefined;
    bar.classList.toggle("open-ended", share === null);
    bar.style.setProperty("--share", `${100 * (share ?? 0)}%`);
    this.offerButtons(buttons);
    return message.state === "used" && before !== undefined && before !== "used";
  }

  offerButtons(buttons) {
    const shown = JSON.stringify(buttons);
    if (shown === this.shown) return;
    this.shown = shown;
    this.buttons = buttons.map(([action, name]) => {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: name, value: action, disabled: !this.mine });
      button.classList.toggle("main", action !== "stop");
      button.onclick = () => this.send({ type: "refine", action });
      return button;
    });
    this.byId("refinement-buttons").replaceChildren(...this.buttons);
  }

  /** Enable the buttons for the driver. */
  status(driver) {
    this.mine = driver;
    for (const button of this.buttons) button.disabled = !driver;
  }
}

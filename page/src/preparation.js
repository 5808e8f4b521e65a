// Progress before the session exists: the phase, a bar, and the time left.
import { showBody } from "./aboutBody.js";

export const duration = (seconds) => (seconds < 90 ? `${Math.max(Math.round(seconds), 1)} s` : `${Math.round(seconds / 60)} min`);

/** A text with a capital letter, without a remark in brackets at its end. */
export const sentence = (text) => text[0].toUpperCase() + text.slice(1).replace(/ \(.*\)$/, "");

/** One line about a message `preparing`. */
export function progressLine({ phase, seconds, seconds_left: left, functions_compiled: compiled }) {
  const first = phase ? sentence(phase) : "Starting";
  if (left !== null) return `${first}: about ${duration(left)} left`;
  return `${first}: ${duration(seconds)}${compiled ? "; compiling, once for this computer" : ""}`;
}

/** Shows the progress in place of the message of the page. */
export class Preparation {
  constructor(byId) {
    Object.assign(this, { byId, active: false });
  }

  show(message) {
    this.active = true;
    showBody(this.byId, message);
    document.body.classList.add("preparing");
    const line = this.byId("message");
    line.hidden = false;
    line.textContent = progressLine(message);
    line.classList.toggle("open-ended", message.fraction === null);
    line.style.setProperty("--share", `${100 * (message.fraction ?? 0)}%`);
  }

  /** The session exists, or has failed. */
  end() {
    this.active = false;
    document.body.classList.remove("preparing");
    this.byId("message").classList.remove("open-ended");
  }
}

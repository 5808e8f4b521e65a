// What is said over the picture, and to a screen reader.

const SHOWN = 5000; // [ms]

export class Notices {
  constructor(byId) {
    Object.assign(this, { byId, errors: [], said: [] });
  }

  /** A line that stays until another one, or none. */
  stay(text) {
    const line = this.byId("notice");
    line.hidden = !text;
    if (line.textContent !== text) line.textContent = text ?? "";
  }

  toast(text, bad = false) {
    this.said.push(text);
    if (bad) this.errors.push(text);
    const toasts = this.byId("toasts");
    if ([...toasts.children].some((toast) => toast.textContent === text)) return;
    const toast = document.createElement("div");
    toast.className = bad ? "toast bad" : "toast";
    toast.textContent = text;
    toasts.append(toast);
    setTimeout(() => toast.remove(), SHOWN);
  }

  speak(text) {
    this.byId("spoken").textContent = text;
  }

  connection(text, kind) {
    this.byId("connection").textContent = text;
    this.byId("dot").className = `dot ${kind}`;
  }
}

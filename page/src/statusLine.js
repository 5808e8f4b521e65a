// The status line, toasts, and announcements for screen readers.

const TOAST_DURATION = 5000; // [ms]

export class StatusLine {
  constructor(byId) {
    Object.assign(this, { byId, errors: [], shown: [] });
  }

  /** Show a message until the next one; null hides it. */
  showMessage(text) {
    const line = this.byId("message");
    line.hidden = !text;
    if (line.textContent !== text) line.textContent = text ?? "";
  }

  showToast(text, bad = false) {
    this.shown.push(text);
    if (bad) this.errors.push(text);
    const toasts = this.byId("toasts");
    if ([...toasts.children].some((toast) => toast.textContent === text)) return;
    const toast = document.createElement("div");
    toast.className = bad ? "toast bad" : "toast";
    toast.textContent = text;
    toasts.append(toast);
    setTimeout(() => toast.remove(), TOAST_DURATION);
  }

  announce(text) {
    this.byId("spoken").textContent = text;
  }

  setConnection(text, kind) {
    this.byId("connection").textContent = text;
    this.byId("dot").className = `dot ${kind}`;
  }
}

// The status line, toasts, and announcements for screen readers.

const TOAST_DURATION = 5000; // [ms]
const CALLOUT_DURATION = 1800;

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

  /** Show a word at a place of the scene [px], for a short time; screen readers read it once. */
  showCallout(text, [x, y]) {
    const callout = this.byId("callout");
    if (callout.textContent !== text || callout.hidden) {
      callout.textContent = text;
      callout.hidden = false;
      this.margins = [callout.offsetWidth / 2 + 8, callout.parentElement.clientWidth - callout.offsetWidth / 2 - 8, callout.offsetHeight + 20];
    }
    const [left, right, top] = this.margins; // measured once, because each measurement costs a layout
    callout.style.left = `${Math.max(Math.min(x, right), left)}px`;
    callout.style.top = `${Math.max(y, top)}px`;
    clearTimeout(this.calloutTimer);
    this.calloutTimer = setTimeout(() => this.hideCallout(), CALLOUT_DURATION);
  }

  hideCallout() {
    this.byId("callout").hidden = true;
    this.byId("callout").textContent = "";
  }

  announce(text) {
    this.byId("spoken").textContent = text;
  }

  setConnection(text, kind) {
    this.byId("connection").textContent = text;
    this.byId("dot").className = `dot ${kind}`;
  }
}

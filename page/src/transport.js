// The toolbar: reset, pause, speed and record; in a replay, the timeline.

export class Transport {
  constructor(byId, send) {
    Object.assign(this, { byId, send, now: {}, canControl: false, held: false });
    const press = (id, act) => (byId(id).onclick = act);
    press("reset", () => this.reset());
    press("undo", () => this.undo());
    press("pause", () => this.pause());
    press("record", () => send({ type: "record", action: this.now.recording ? "stop" : "start" }));
    press("play", () => send({ type: "replay", action: this.now.state === "running" ? "pause" : "play" }));
    press("live", () => send({ type: "replay", action: "live" }));
    byId("speed").onchange = ({ target }) => send({ type: "speed", factor: Number(target.value) });
    byId("time").oninput = ({ target }) => this.seek(Number(target.value));
    byId("time").onpointerdown = () => (this.held = true);
    addEventListener("pointerup", () => (this.held = false));
  }

  offer({ mode, duration, returns, tools }) {
    this.replay = mode === "replay";
    this.duration = duration ?? 0;
    this.byId("transport").hidden = this.replay;
    this.byId("replay").hidden = !this.replay;
    this.byId("live").hidden = !returns;
    this.byId("undo").hidden = !tools.includes("scalpel");
    if (this.replay) Object.assign(this.byId("time"), { max: this.duration, step: this.duration / 1000 || 0.001 });
  }

  status(status, driver) {
    this.now = status;
    this.canControl = driver;
    const { byId } = this;
    for (const id of ["reset", "pause", "record", "speed"]) byId(id).disabled = !driver;
    byId("undo").disabled = !this.canUndo;
    const paused = status.state !== "running";
    byId("pause").setAttribute("aria-pressed", paused);
    byId("pause-text").textContent = paused ? "Resume" : "Pause";
    byId("play").setAttribute("aria-pressed", paused);
    byId("play").setAttribute("aria-label", paused ? "Play" : "Pause");
    byId("record").setAttribute("aria-pressed", Boolean(status.recording));
    byId("record-text").textContent = status.recording ? "Stop" : "Record";
    byId("speed").value = String(status.speed ?? 1);
  }

  reset() {
    if (this.canControl) this.send({ type: "control", action: "reset" });
  }

  get canUndo() {
    return this.canControl && this.now.strokes > 0;
  }

  /** Take the last cut back. */
  undo() {
    if (this.canUndo) this.send({ type: "control", action: "undo" });
  }

  pause() {
    if (this.replay) this.byId("play").click();
    else if (this.canControl) this.send({ type: "control", action: this.now.state === "running" ? "pause" : "resume" });
  }

  seek(time) {
    this.send({ type: "replay", action: "seek", time });
    this.show(time);
  }

  time(time) {
    if (this.replay && !this.held) {
      this.byId("time").value = time;
      this.show(time);
    }
  }

  show(time) {
    this.byId("time").style.setProperty("--share", `${(100 * time) / (this.duration || 1)}%`);
    this.byId("time-text").textContent = `${time.toFixed(2)} of ${this.duration.toFixed(2)} s`;
  }
}

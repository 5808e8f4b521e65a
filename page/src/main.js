// The page: connects the session with the scene, the input controls and the panel.
import "./style.css";
import { Vector3 } from "three";
import { InputControls } from "./inputControls.js";
import { LabelChoice } from "./labelChoice.js";
import { Legend, updateScaleBar } from "./legend.js";
import { LocalConnection, localModel } from "./localConnection.js";
import { paceText } from "./forceText.js";
import { FrameMeter } from "./meter.js";
import { StatusLine } from "./statusLine.js";
import { Panel } from "./panel.js";
import { Plots } from "./plots.js";
import { Preparation } from "./preparation.js";
import { Connection } from "./protocol.js";
import { Refinement } from "./refinement.js";
import { Scene } from "./scene.js";
import { Surroundings, SurroundingsPanel, shapeName } from "./surroundings.js";
import { theme } from "./theme.js";
import { Transport } from "./transport.js";

const byId = (id) => document.getElementById(id);
const statusLine = new StatusLine(byId);
const meter = new FrameMeter();
const legend = new Legend(byId);
const preparation = new Preparation(byId);
const FRICTION = 0.2;
const COUPLING_STIFFNESS = 300; // [N/m], smooths the motion of a mouse
const READOUT_INTERVAL = 60; // [ms] between updates of the readings
const SPEECH_INTERVAL = 1500; // [ms] between announcements
const AIR_TIME = 0.5; // [s] without a force after which a tool is in the air
const LEAST_FORCE = 2e-3; // [N] of a tool that touches

const session = { hello: null, space: "", status: {}, scalar: "displacement", state: null, next: null, waiting: null, tool: null, tools: {} };
const replaying = () => session.hello?.mode === "replay";
const driver = () => Boolean(session.status.driver) && !replaying();
const send = (message) => connection.send(message);

const page = {
  driver,
  send,
  tool: () => session.tool,
  requestControl() {
    if (replaying()) return;
    if (!session.hello) return statusLine.showToast("The body is being prepared.");
    statusLine.showToast("Another viewer controls the tool.");
    byId("drive").focus();
  },
  poseSent: (sequence, stamp) => meter.poseSent(sequence, stamp),
  missed: (why, place) => statusLine.showCallout(why, place),
  /** Name the nearest shape, or the one behind it where that is marked. */
  clicked(coordinates, distance, place) {
    const shapes = scene.shapesUnder(...coordinates, distance);
    const shape = shapes[shapes.indexOf(scene.surroundings?.marked) + 1] ?? shapes[0];
    if (scene.surroundings && (shape !== undefined || distance === Infinity)) mark(shape ?? -1);
    if (shape !== undefined) statusLine.showCallout(shapeName(scene.surroundings.names[shape]), place);
    return shape !== undefined;
  },
  pressChanged(press) {
    if (press && session.status.state === "paused") statusLine.showToast("The session is paused: resume it to move the body.");
    if (!press) statusLine.announce("Released");
  },
};

let scene, controls, plots, panel, transport, refinement, surroundings, choice, connection;

function start() {
  try {
    scene = new Scene(byId("view"));
  } catch (error) {
    statusLine.setConnection("No WebGL", "bad");
    statusLine.showMessage(error.message);
    return;
  }
  plots = new Plots(byId);
  panel = new Panel(byId, { send, choose, change, scalar });
  transport = new Transport(byId, (message) => {
    if (message.action === "reset" && controls.press) controls.release();
    send(message);
  });
  refinement = new Refinement(byId, send);
  surroundings = new SurroundingsPanel(byId, scene.fine, (shown) => scene.showSurroundings(shown), mark);
  choice = new LabelChoice(byId, send);
  controls = new InputControls(scene, page);
  theme(byId("theme"), (accent, dark) => {
    scene.setColours(accent, dark);
    plots.draw(performance.now(), true);
  });
  byId("drive").onclick = () => send({ type: "drive" });
  byId("help-open").onclick = () => byId("help").showModal();
  byId("overlay").onchange = () => {
    scene.overlay.lines.visible = byId("overlay").checked;
    scene.dirty = true;
  };
  addEventListener("keydown", key);
  addEventListener("keydown", () => (document.documentElement.dataset.by = "keys"), true);
  addEventListener("pointerdown", () => (document.documentElement.dataset.by = "pointer"), true);
  addEventListener("online", () => connection?.reconnect());
  document.addEventListener("visibilitychange", () => document.hidden || connection?.reconnect());
  const token = location.hash.slice(1);
  if (localModel()) connection = new LocalConnection(localModel(), { message, frame });
  else if (!token) {
    statusLine.setConnection("Not connected", "bad");
    statusLine.showMessage("Open the complete address that palpate view prints, including the part after #.");
  } else connection = new Connection(`ws://${location.host}/session`, token, { message, frame, lost, ended });
  let last = performance.now();
  requestAnimationFrame(function again(now) {
    requestAnimationFrame(again);
    renderFrame(now, Math.max((now - last) / 1000, 0));
    last = now;
  });
  publish();
}

// messages from the server

const answers = {
  labels(message) {
    statusLine.setConnection("Choose the body", "");
    choice.show(message);
  },
  preparing(message) {
    choice.end();
    session.space = message.space;
    statusLine.setConnection("Preparing", "");
    preparation.show(message);
  },
  failed({ reason }) {
    choice.end();
    connection.close();
    preparation.end();
    statusLine.setConnection("Ended", "bad");
    statusLine.showMessage(reason);
  },
  hello(message) {
    choice.end();
    preparation.end();
    if (controls.press) controls.release(); // of the body that was shown
    session.hello = message;
    session.space = message.space;
    session.status = { driver: false, viewers: message.viewers, state: "running", speed: 1 };
    session.tools = { ...initialTools(message), ...session.tools };
    refinement.offer();
    byId("title").textContent = message.title;
    document.title = `${message.title} · palpate`;
    document.body.classList.toggle("replaying", replaying());
    const [low, high] = message.bounds;
    panel.offer(message, Math.hypot(...high.map((part, k) => part - low[k])));
    transport.offer(message);
    Object.assign(session, { pace: 1, fullNewtons: NaN });
    if (message.compare) byId("overlay").checked = true;
    statusLine.showMessage(message.training_errors?.advice);
    const names = ["none", ...message.scalars.map(({ name }) => name)];
    scalar(names.includes(session.scalar) ? session.scalar : "none");
    answers.status({ driver: message.driver, tool: message.tool });
  },
  status(message) {
    const before = driver();
    Object.assign(session.status, message);
    adoptTool(message.tool);
    panel.materials(message.materials);
    if (driver() && !before && scene.body?.count === session.hello.vertices) sendTool();
    showStatus();
  },
  statistics(message) {
    panel.statistics(message);
    session.pace = message.pace ?? 1;
    showConnection();
    // A hidden page renders no frames. It must acknowledge them, or the server closes the connection.
    if (session.next && session.next === session.waiting) send({ type: "ack", sequence: session.next.sequence });
    session.waiting = session.next;
  },
  error({ reason }) {
    if (choice.fail(reason)) return;
    statusLine.showToast(reason, true);
    if (controls.press?.tool.kind !== "grasp" || session.state?.tool === "grasp") return;
    statusLine.showCallout("cannot hold here", scene.project(controls.press.hit.point.toArray()));
    controls.release();
  },
  refinement(message) {
    if (refinement.show(message)) {
      statusLine.showToast(["The finer model is in use.", message.note].filter(Boolean).join(" "));
      statusLine.announce("The finer model is in use.");
    }
  },
  recorded: ({ file, frames }) => statusLine.showToast(`${frames} frames recorded in ${file}`),
};

function message(received) {
  answers[received.type]?.(received);
}

function frame(received) {
  if (received.kind === 2) session.next = received;
  else if (received.kind === 5 || received.kind === 6) scene.setBody(received);
  else if (received.kind === 7) {
    scene.setSurroundings(new Surroundings(received), surroundings.asked);
    surroundings.offer(received.names);
  } else if (received.kind === 1) {
    scene.setBody(received);
    byId("fixed-key").hidden = !received.fixed.includes(1);
    if (driver()) sendTool();
    scene.overlay.lines.visible = byId("overlay").checked && session.hello.overlay;
  } else if (received.kind === 3) {
    scene.overlay?.update(received.positions);
    session.fullNewtons = received.newtons;
    scene.dirty = true;
  }
}

function lost(seconds) {
  choice.end();
  session.next = null;
  if (controls.press) controls.release();
  session.status.driver = false;
  statusLine.setConnection("Not connected", "bad");
  statusLine.showMessage(`Connection lost. Reconnecting ${seconds < 1 ? "now" : `in ${Math.round(seconds)} s`} …`);
  byId("watching").hidden = true;
}

function ended(why) {
  choice.end();
  statusLine.setConnection("Not connected", "bad");
  const reasons = {
    token: "This address has expired. Open the one that palpate view printed last.",
    full: "Too many viewers. Close another page, then reload this one.",
    refused: "The session does not accept this page. Reload it, or update palpate.",
  };
  statusLine.showMessage(reasons[why]);
}

/** Show whether the body lives, and its pace where that is not real time. */
function showConnection() {
  const { status } = session;
  const viewers = status.viewers > 1 ? `, ${status.viewers} viewers` : "";
  const pause = { sleep: "after sleep", "viewers left": "no viewers" }[status.pause_reason] ?? status.pause_reason;
  const why = pause ? `: ${pause}` : "";
  const pace = paceText(session.pace);
  const names = { running: pace ? `Live, ${pace}` : "Live", paused: `Paused${why}`, stopped: "Stopped", diverged: "Diverged: reset to continue" };
  const live = status.state === "running";
  statusLine.setConnection((replaying() ? "Replay" : names[status.state]) + viewers, live ? "live" : status.state === "diverged" ? "bad" : "");
}

function showStatus() {
  const { status } = session;
  showConnection();
  byId("watching").hidden = driver() || replaying();
  if (controls.press && !driver()) {
    controls.press = null;
    statusLine.showToast("Another viewer now controls the tool.");
  }
  panel.status({ tool: session.tool, driver: driver() }, replaying());
  transport.status(status, driver());
  refinement.status(driver());
  scene.dirty = true;
}

// input of the user

/** Initial sizes of each kind of tool, from the size of the body. */
function initialTools({ bounds: [low, high], spacing, full, compare, tools, tool_parameters: parameters = {} }) {
  const size = Math.hypot(...high.map((part, k) => part - low[k]));
  const round = (metres) => Math.max(Math.round(1e3 * metres), 1) / 1e3;
  const least = full || compare ? Math.ceil(2e3 * spacing) / 2e3 : 0; // of a tool that touches a full body
  const held = { friction: FRICTION, stiffness: compare ? null : COUPLING_STIFFNESS };
  const fitted = {
    sphere: { radius: Math.max(round(0.075 * size), least) },
    capsule: { radius: Math.max(round(0.04 * size), least), length: round(0.2 * size) },
    scalpel: { length: Math.max(round(0.15 * size), 2 * least) },
    grasp: { radius: round(Math.max(0.05 * size, 1.5 * (spacing ?? 0))) },
  };
  const usual = (kind) => Object.fromEntries((parameters[kind] ?? []).map(({ name, usual: value }) => [name, value]));
  return Object.fromEntries(tools.map((kind) => [kind, { kind, ...held, ...usual(kind), ...fitted[kind] }]));
}

/** Adopt the tool of the session; viewers who watch show the driver's tool. */
function adoptTool(tool) {
  const first = session.tools[session.hello.tools[0]] ?? tool;
  if (tool && tool.kind !== "none" && (!driver() || tool.kind === "group")) session.tool = { ...tool };
  session.tool ??= { ...first };
  if (tool?.kind === session.tool.kind) session.tool.outline = tool.outline;
}

function choose(kind) {
  if (kind === session.tool.kind || !driver()) return;
  if (controls.press) controls.release();
  session.tools[session.tool.kind] = session.tool;
  session.tool = session.tools[kind];
  sendTool();
}

/** Mark a shape around the body; none for -1. */
function mark(shape) {
  scene.markShape(shape);
  surroundings.mark(shape);
  if (shape >= 0) statusLine.announce(shapeName(scene.surroundings.names[shape]));
}

/** Change fields of the tool. */
function change(part) {
  if (controls.press) controls.release();
  session.tool = { ...session.tool, ...part };
  sendTool();
}

/** Send the tool to the session: put down next to the body, then released. Forceps are sent when they grasp. */
function sendTool() {
  const { tool } = session;
  const { sphere } = scene.body;
  if (tool.kind !== "grasp" && tool.kind !== "group") {
    const far = sphere.radius + 2 * (tool.radius ?? 0) + (tool.length ?? 0);
    const position = [sphere.center.x, sphere.center.y, sphere.center.z + far];
    send({ ...tool, type: "tool", position, quaternion: [1, 0, 0, 0] });
    send({ type: "release" });
  }
  showStatus();
}

function scalar(name) {
  session.scalar = name;
  legend.reset(session.hello.scalars.find((each) => each.name === name) ?? null);
  panel.scalar(name);
  scene.body?.setColourRange(null);
  scene.dirty = true;
  send({ type: "show", scalar: name });
}

function key(event) {
  if (byId("help").open || !byId("choice").hidden || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.id === "surroundings-names" && event.key !== "Escape") return; // letters find a name
  const field = event.target.matches?.("input, select, button");
  if (field && [" ", "Enter", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"].includes(event.key)) return;
  const kinds = session.hello?.tools ?? [];
  const meanings = { r: () => transport.reset(), p: () => transport.pause(), f: () => scene.orbitCamera.reset(), s: () => surroundings.toggle(), escape: () => scene.surroundings && mark(-1), "?": () => byId("help").showModal() };
  const meaning = meanings[event.key.toLowerCase()] ?? (kinds[event.key - 1] && (() => choose(kinds[event.key - 1])));
  if (meaning) meaning();
  else if (!scene.body || !controls.key(event)) return;
  event.preventDefault();
}

// each frame

function renderFrame(now, seconds) {
  meter.framePresented(now);
  const state = session.next;
  const fresh = state !== null && scene.body?.count * 3 === state.positions.length;
  session.next = null;
  if (fresh) showState(state, now, seconds);
  if (scene.body) {
    controls.update(seconds, session.state);
    showTool(session.state);
    showAir(session.state, seconds);
  }
  if (scene.draw(seconds)) updateScaleBar(byId, scene.metresPerPixel(), session.space, scene.rightward());
  updateReadings(now);
  if (fresh) {
    meter.stateRendered(state);
    send({ type: "ack", sequence: state.sequence });
  }
  if (session.state?.state === "running" || replaying()) plots.draw(now);
  byId("view").classList.toggle("over", scene.ghost.group.visible || Boolean(controls.press));
}

function showState(state, now, seconds) {
  session.state = state;
  scene.body.update(state);
  scene.body.setColourRange(session.scalar === "none" ? null : legend.updateRange(state, seconds));
  scene.dirty = true;
  const beyond = panel.judge(state);
  scene.tool.warn(beyond);
  if (state.state === "running") plots.add(now, state, beyond, session.fullNewtons);
  transport.time(state.time);
  announceForce(state, now);
}

/** Update the readings at a rate at which they can be read. */
let lastReading = { at: 0, state: null };
function updateReadings(now) {
  if (!session.state || lastReading.state === session.state || now - lastReading.at < READOUT_INTERVAL) return;
  lastReading = { at: now, state: session.state };
  panel.state(session.state, session.fullNewtons);
}

let lastAnnouncement = 0;
function announceForce(state, now) {
  if (!controls.press || now - lastAnnouncement < SPEECH_INTERVAL) return;
  lastAnnouncement = now;
  const { lead, value, range, note } = panel.force(state);
  const words = value ? `${lead} ${value} newtons${range && `, ${range}`}` : note;
  statusLine.announce(`${(1e3 * controls.press.depth).toFixed(1)} millimetres, ${words}`);
}

/** Say that a tool touches nothing, or is inside the body, next to the tool. */
let airTime = 0;
function showAir(state, seconds) {
  const { press } = controls;
  const touches = !press || press.grasps || press.tool.kind === "scalpel" || press.approach > 0 || state?.state !== "running" || state.newtons > LEAST_FORCE;
  const before = airTime;
  airTime = touches ? 0 : airTime + seconds;
  panel.through = airTime > AIR_TIME && scene.body.isInside(press.position);
  if (airTime > AIR_TIME) statusLine.showCallout(panel.through ? "slipped through" : "in the air", scene.project(press.position.toArray()));
  else if (before > AIR_TIME) statusLine.hideCallout();
}

/** Draw the tool: at the driver's pointer for a rigid coupling, otherwise at the pose of the session. */
function showTool(state) {
  const { tool: mark, arrow, size } = scene;
  const { tool } = session;
  const there = controls.press !== null || (state && state.tool !== "none");
  mark.group.visible = Boolean(there && tool && tool.kind !== "group" && size);
  arrow.group.visible = false;
  if (!there || !tool) return;
  const own = controls.press && (!tool.stiffness || state?.tool === "none");
  const [position, quaternion] = own ? [controls.press.position.toArray(), controls.press.quaternion] : [state.position, state.quaternion];
  mark.shape(tool, size);
  mark.at(position, quaternion);
  const ball = tool.kind === "sphere" || tool.kind === "capsule" ? tool.radius : 0;
  if (controls.press && !own) showPointer(position, tool);
  if (state && state.tool !== "none" && !panel.beyond) arrow.show(position, state.force, state.newtons, size, ball, tool.kind === "grasp");
}

/** Draw the pose of the pointer where a soft coupling separates it from the tool. */
function showPointer(position, tool) {
  const { ghost, size } = scene;
  const at = controls.press.position;
  ghost.group.visible = tool.kind !== "grasp" && at.distanceTo(new Vector3().fromArray(position)) > 0.004 * size;
  ghost.shape(tool, size);
  ghost.at(at.toArray(), controls.press.quaternion);
}

/** State for tests. */
function publish() {
  window.palpate = {
    meter,
    statusLine,
    session,
    scene,
    get force() { return session.state?.newtons ?? 0; },
    get driver() { return driver(); },
    get viewers() { return session.status.viewers ?? 0; },
    get ready() { return session.state !== null; },
    project: (point) => scene.project(point),
  };
}

start();

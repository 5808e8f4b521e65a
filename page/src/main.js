// The page: connects the session with the scene, the input controls and the panel.
import "./style.css";
import { showBody } from "./aboutBody.js";
import { BodyEnd } from "./bodyEnd.js";
import { BodyMenu } from "./bodyMenu.js";
import { HandList } from "./handList.js";
import { Hands, titleOf } from "./hands.js";
import { openHelp } from "./help.js";
import { InputControls } from "./inputControls.js";
import { LabelChoice } from "./labelChoice.js";
import { Legend, updateScaleBar } from "./legend.js";
import { LocalConnection, localModel } from "./localConnection.js";
import { depthText, paceText } from "./forceText.js";
import { FrameMeter } from "./meter.js";
import { StatusLine } from "./statusLine.js";
import { Panel } from "./panel.js";
import { Plots } from "./plots.js";
import { Preparation } from "./preparation.js";
import { Connection, socketAddress } from "./protocol.js";
import { Refinement } from "./refinement.js";
import { Scene } from "./scene.js";
import { Surroundings, SurroundingsPanel, shapeName } from "./surroundings.js";
import { theme } from "./theme.js";
import { ToolHints } from "./toolHints.js";
import { initialTools, offerDepth } from "./toolSettings.js";
import { placeMessages } from "./titleRoom.js";
import { showTools } from "./toolView.js";
import { Transport } from "./transport.js";

const byId = (id) => document.getElementById(id);
const statusLine = new StatusLine(byId);
const meter = new FrameMeter();
const legend = new Legend(byId);
const preparation = new Preparation(byId);
const bodyEnd = new BodyEnd(byId);
const READOUT_INTERVAL = 60; // [ms] between updates of the readings
const SPEECH_INTERVAL = 1500; // [ms] between announcements
const END_ROOM = 1.15; // for an end that is pulled
const AIR_TIME = 0.5; // [s] without a force after which a tool is in the air
const HOVER_INTERVAL = 50; // [ms] between two looks for a shape under the mouse
const UNDO_TIME = 3000; // [ms] after an undo within which a body that starts from rest does so because of it
const MIN_FORCE = 2e-3; // [N] of a tool that touches

const session = { hello: null, space: "", status: {}, scalar: "displacement", state: null, next: null, nextTools: null, waiting: null,
  get tool() { return hands.tool; },
};
const replaying = () => session.hello?.mode === "replay";
const driver = () => Boolean(session.status.driver) && !replaying();
const send = (message) => connection.send(message);

const page = {
  driver,
  send,
  address: (index) => hands.address(index),
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
    if (press) lastKind = press.tool.kind;
    else hints.use(lastKind);
    if (press && session.status.state === "paused") statusLine.showToast("The session is paused: resume it to move the body.");
    if (!press && !hands.held.length) statusLine.announce("Released");
  },
};

const hands = new Hands({
  send,
  driver,
  /** A place next to the body for a tool. */
  place(tool) {
    const { sphere } = scene.body;
    const far = sphere.radius + 2 * (tool.radius ?? 0) + (tool.length ?? 0);
    return [sphere.center.x, sphere.center.y, sphere.center.z + far];
  },
  say: (text) => statusLine.showToast(text),
  announce: (text) => statusLine.announce(text),
  changed: () => showStatus(),
});

let lastKind = ""; // of the last press
let undone = null; // after a cut was taken back: the time of the body then [s], and the page's [ms]
let scene, controls, hints, handList, plots, panel, transport, refinement, bodyMenu, surroundings, choice, connection;

function start() {
  try {
    scene = new Scene(byId("view"));
  } catch (error) {
    statusLine.setConnection("No WebGL", "bad");
    statusLine.showMessage(error.message);
    return;
  }
  placeMessages(byId);
  plots = new Plots(byId);
  panel = new Panel(byId, { send, choose, change, scalar });
  transport = new Transport(byId, (message) => {
    const ends = { reset: () => true, undo: ({ cuts }) => cuts }[message.action] ?? (() => false);
    for (const press of controls.presses.filter(ends)) controls.release(press);
    undone = message.action === "undo" ? { time: session.state?.time ?? 0, at: performance.now() } : null;
    send(message);
    if (message.action === "reset") hands.reset();
  });
  refinement = new Refinement(byId, send);
  bodyMenu = new BodyMenu(byId, send);
  surroundings = new SurroundingsPanel(byId, scene.fine, (shown) => scene.showSurroundings(shown), mark);
  choice = new LabelChoice(byId, send);
  hints = new ToolHints(byId("hint"), byId("sizes"));
  controls = new InputControls(scene, page, hands);
  handList = new HandList(byId, hands, scene, {
    hold: () => controls.hold(),
    take: (index) => controls.grab(index),
    release: releaseTool,
  });
  theme(byId("theme"), (accent, dark) => {
    scene.setColours(accent, dark, handColours());
    plots.draw(performance.now(), true);
  });
  byId("drive").onclick = () => send({ type: "drive" });
  byId("help-open").onclick = help;
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
  } else connection = new Connection(socketAddress(location.href), token, { message, frame, lost, ended });
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
    for (const press of [...controls.presses]) controls.release(press); // of the body that was shown
    session.hello = message;
    undone = null;
    session.space = message.space;
    session.status = { end_tools: message.end_tools, driver: false, viewers: message.viewers, state: "running", speed: 1 };
    offerDepth(message);
    hands.offer(message, initialTools(message));
    refinement.offer();
    bodyMenu.offer();
    bodyEnd.offer(message);
    scene.room = message.end ? END_ROOM : 1;
    showBody(byId, message);
    document.body.classList.toggle("replaying", replaying());
    const [low, high] = message.bounds;
    panel.offer(message, Math.hypot(...high.map((part, k) => part - low[k])));
    transport.offer(message);
    plots.offer(message);
    Object.assign(session, { pace: 1, fullNewtons: NaN });
    if (message.compare) byId("overlay").checked = true;
    statusLine.showMessage(message.training_errors?.advice);
    const names = ["none", ...message.scalars.map(({ name }) => name)];
    scalar(names.includes(session.scalar) ? session.scalar : "none");
    answers.status({ driver: message.driver, tool: message.tool, all_tools: message.all_tools });
  },
  status(message) {
    const before = driver();
    if (undone && message.strokes < session.status.strokes) statusLine.announce("The last cut is undone.");
    Object.assign(session.status, message);
    hands.adopt(message.all_tools ?? [message.tool]);
    bodyEnd.status(session.status);
    if (message.devices) hands.devices = new Map(message.devices);
    panel.materials(message.materials);
    if (driver() && !before && scene.body?.count === session.hello.vertices) hands.start();
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
    const { press } = controls;
    if (press?.tool.kind !== "grasp" || press.taken || hands.state(press.index).kind === "grasp") return;
    statusLine.showCallout("cannot hold here", scene.project(controls.press.hit.point.toArray()));
    controls.release();
  },
  refinement(message) {
    if (refinement.show(message)) {
      statusLine.showToast(["The finer model is in use.", message.note].filter(Boolean).join(" "));
      statusLine.announce("The finer model is in use.");
    }
  },
  bodies: (message) => bodyMenu.show(message),
  recorded: ({ file, frames }) => statusLine.showToast(`${frames} frames recorded in ${file}`),
};

function message(received) {
  answers[received.type]?.(received);
}

function frame(received) {
  if (received.kind === 2) session.next = received;
  else if (received.kind === 8) session.nextTools = received;
  else if (received.kind === 5 || received.kind === 6) scene.setBody(received);
  else if (received.kind === 7) {
    scene.setSurroundings(new Surroundings(received), surroundings.asked);
    surroundings.offer(received);
    scene.setEdges(received.edges, session.hello?.spacing ?? 0);
    byId("edge-key").hidden = !scene.edges.shown;
  } else if (received.kind === 1) {
    scene.edges.spacing = session.hello.spacing;
    scene.setBody(received);
    byId("edge-key").hidden = !scene.edges.shown;
    byId("fixed-key").hidden = !received.fixed.includes(1);
    if (driver()) hands.start();
    scene.overlay.lines.visible = byId("overlay").checked && session.hello.overlay;
  } else if (received.kind === 3) {
    scene.overlay?.update(received.positions);
    session.fullNewtons = received.newtons;
    scene.dirty = true;
  }
}

function lost(seconds, opened) {
  choice.end();
  session.next = session.nextTools = null;
  controls.forget();
  session.status.driver = false;
  statusLine.setConnection("Not connected", "bad");
  const again = `Reconnecting ${seconds < 1 ? "now" : `in ${Math.round(seconds)} s`} …`;
  const page = new URL(".", location.href).href;
  const remedy = `palpate has ended, or lets no socket through: behind a proxy start it with --public-url ${page}`;
  statusLine.showMessage(opened ? `Connection lost. ${again}` : `No connection: ${remedy}. ${again}`);
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
  if (controls.presses.length && !driver()) {
    controls.forget();
    statusLine.showToast("Another viewer now controls the tool.");
  }
  panel.status({ tool: session.tool, driver: driver(), fast: status.fast }, replaying());
  transport.status(status, driver());
  refinement.status(driver());
  bodyMenu.status(driver());
  handList.show(driver());
  hints.show(driver() && session.state ? hintedKind() : null);
  scene.dirty = true;
}

// input of the user

function help() {
  openHelp(byId, session.hello, Boolean(scene?.surroundings));
}

function choose(kind) {
  if (kind === session.tool.kind || !driver()) return;
  controls.putAside();
  hands.choose(kind);
}

/** Whether a key takes the last cut back. */
const isUndo = ({ key: letter, ctrlKey, metaKey, altKey, shiftKey }) => letter.toLowerCase() === "z" && (ctrlKey || metaKey) && !altKey && !shiftKey;

/** Mark a shape around the body; none for -1. */
function mark(shape) {
  scene.markShape(shape);
  surroundings.mark(shape);
  if (shape >= 0) statusLine.announce(shapeName(scene.surroundings.names[shape]));
}

/** Change fields of the tool in hand. */
function change(part) {
  if (controls.press) controls.release();
  hands.change(part);
}

/** Release a tool, in hand or held. */
function releaseTool(index) {
  const press = controls.presses.find((each) => each.index === index);
  if (press) controls.release(press);
  else hands.release(index);
}

/** Colours of the forces of tools by index. */
function handColours() {
  const style = getComputedStyle(document.documentElement);
  return [0, 1, 2, 3].map((index) => style.getPropertyValue(`--tool-${index}`).trim());
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
  if (isUndo(event) && !byId("help").open && byId("choice").hidden) {
    if (!event.repeat) transport.undo();
    return event.preventDefault();
  }
  if (byId("help").open || !byId("choice").hidden || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.id === "surroundings-names" && event.key !== "Escape") return; // letters find a name
  const field = event.target.matches?.("input, select, button");
  if (field && [" ", "Enter", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"].includes(event.key)) return;
  const kinds = session.hello?.tools ?? [];
  const meanings = { r: () => transport.reset(), p: () => transport.pause(), h: () => driver() && controls.hold(), delete: () => controls.release(), f: () => scene.orbitCamera.reset(), s: () => surroundings.toggle(), escape: () => scene.surroundings && mark(-1), "?": help };
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
    showTools(scene, hands, controls.presses, panel.beyond);
    handList.place();
    showAir(session.state, seconds);
    nameUnderMouse(now);
  }
  if (scene.draw(seconds)) updateScaleBar(byId, scene.metresPerPixel(), session.space, scene.rightward());
  updateReadings(now);
  if (fresh) {
    meter.stateRendered({ pose: Math.max(...hands.slots.map((slot) => slot.state.pose)) });
    send({ type: "ack", sequence: state.sequence });
  }
  if (session.state?.state === "running" || replaying()) plots.draw(now);
  byId("view").classList.toggle("over", scene.ghost.group.visible || controls.presses.length > 0);
  byId("view").classList.toggle("held", controls.overHeld >= 0);
}

/** The kind of the tool in hand; null of forceps where the page already says that they pull its end. */
function hintedKind() {
  const kind = session.tool?.kind;
  return session.hello?.end && kind === "grasp" ? null : kind;
}

function showState(state, now, seconds) {
  const first = session.state === null;
  session.state = state;
  if (first) hints.show(driver() ? hintedKind() : null);
  if (undone && state.time < undone.time) {
    statusLine.showToast("The wound was too wide to be closed at once: the body starts from rest.");
    hands.reset();
    undone = null;
  } else if (undone && now - undone.at > UNDO_TIME) undone = null;
  scene.body.update(state);
  bodyEnd.update(scene.body);
  scene.body.setColourRange(session.scalar === "none" ? null : legend.updateRange(state, seconds));
  scene.dirty = true;
  const beyond = panel.judge(state);
  hands.update(statesOf(state));
  if (state.state === "running") plots.add(now, state, beyond, session.fullNewtons, hands.slots.map((slot) => slot.state));
  const depth = pressDepth();
  if (state.state === "running" && depth !== null) plots.curve.add(controls.press, depth, beyond ? null : hands.state(controls.press.index).newtons);
  transport.time(state.time);
  announceForce(state, now);
}

/** States of all tools: of their own frame, or of the first tool alone. */
function statesOf({ sequence, tool, force, newtons, position, quaternion, pose }) {
  const { nextTools } = session;
  if (nextTools?.sequence === sequence) return nextTools.tools;
  return [{ kind: tool, pinned: false, force, newtons, position, quaternion, pose }];
}

/** A state with the force of the tool that is read. */
const handState = (state) => ({ ...state, newtons: hands.state(hands.read).newtons });

/** The depth [m] of the press in hand, as the session has it, or how far it has moved the end; null without one, and until the session answers its poses. */
function pressDepth() {
  const { press } = controls;
  const tool = press && hands.state(press.index);
  if (press && bodyEnd.holds(press.index)) return bodyEnd.moved;
  return tool && tool.kind !== "none" && tool.pose >= press.first ? press.depthAt(tool.position) : null;
}

/** Update the readings at a rate at which they can be read. */
let lastReading = { at: 0, state: null };
function updateReadings(now) {
  if (!session.state || lastReading.state === session.state || now - lastReading.at < READOUT_INTERVAL) return;
  lastReading = { at: now, state: session.state };
  const shown = handState(session.state);
  panel.state(shown, session.fullNewtons);
  const held = hands.read === hands.inHand ? "" : `${titleOf(hands.read, hands.slots[hands.read].tool.kind)}, held`;
  panel.press(airTime > AIR_TIME ? null : pressDepth(), shown.newtons, held, controls.press && bodyEnd.holds(controls.press.index));
  bodyEnd.show(hands.slots.map((slot) => slot.state), !panel.beyond && !panel.through);
  handList.show(driver());
  handList.update(panel.beyond);
}

let lastAnnouncement = 0;
function announceForce(state, now) {
  if (!controls.press || now - lastAnnouncement < SPEECH_INTERVAL) return;
  lastAnnouncement = now;
  const { lead, value, range, note } = panel.force(handState(state));
  const words = value ? `${lead} ${value} newtons${range && `, ${range}`}` : note;
  const depth = pressDepth();
  statusLine.announce([depth === null ? "" : `${depthText(Math.max(depth, 0))} millimetres`, words].filter(Boolean).join(", "));
}

/** Name the shape next to the body at which a mouse points. */
let lastName = { at: 0, key: "" };
function nameUnderMouse(now) {
  const { hover, presses, pointers } = controls;
  const free = hover && scene.surroundingsShown && presses.length === 0 && pointers.size === 0;
  const key = free ? [...hover, ...scene.camera.position.toArray()].join() : "";
  if (key === lastName.key || (free && now - lastName.at < HOVER_INTERVAL)) return;
  lastName = { at: now, key };
  const [shape] = free && !scene.pick(...hover) ? scene.shapesUnder(...hover, Infinity) : [];
  scene.hoverShape(shape ?? -1);
  const label = byId("hover-name");
  label.hidden = shape === undefined;
  if (label.hidden) return;
  label.textContent = shapeName(scene.surroundings.names[shape]);
  const half = label.offsetWidth / 2 + 8;
  label.style.left = `${Math.max(Math.min((0.5 + 0.5 * hover[0]) * scene.width, scene.width - half), half)}px`;
  label.style.top = `${Math.max((0.5 - 0.5 * hover[1]) * scene.height, label.offsetHeight + 20)}px`;
}

/** Say that a tool touches nothing, or is inside the body, next to the tool. */
let airTime = 0;
function showAir(state, seconds) {
  const { press } = controls;
  const touches = !press || press.grasps || press.tool.kind === "scalpel" || press.approach > 0 || state?.state !== "running" || hands.state(press.index).newtons > MIN_FORCE;
  const before = airTime;
  airTime = touches ? 0 : airTime + seconds;
  panel.through = airTime > AIR_TIME && scene.body.isInside(press.position);
  if (airTime > AIR_TIME) statusLine.showCallout(panel.through ? "slipped through" : "in the air", scene.project(press.position.toArray()));
  else if (before > AIR_TIME) statusLine.hideCallout();
}

/** State for tests. */
function publish() {
  window.palpate = {
    meter,
    statusLine,
    session,
    scene,
    hands,
    controls,
    plots,
    get force() { return session.state ? hands.state(hands.inHand).newtons : 0; },
    get driver() { return driver(); },
    get viewers() { return session.status.viewers ?? 0; },
    get ready() { return session.state !== null; },
    project: (point) => scene.project(point),
  };
}

start();

// The page: a connection, a picture, a hand and a panel, and what they tell each other.
import "./style.css";
import { Vector3 } from "three";
import { Hand } from "./hand.js";
import { Legend, Meter, showScale } from "./measures.js";
import { Notices } from "./notices.js";
import { Panel } from "./panel.js";
import { Plots } from "./plots.js";
import { Connection } from "./protocol.js";
import { Stage } from "./stage.js";
import { theme } from "./theme.js";
import { Transport } from "./transport.js";

const byId = (id) => document.getElementById(id);
const notices = new Notices(byId);
const meter = new Meter();
const legend = new Legend(byId);
const FRICTION = 0.2;
const COUPLING = 300; // [N/m] between hand and tool: calm, and soft enough that little is lost of the force
const READ = 60; // [ms] at least between two readings
const SPOKEN = 1500; // [ms] at least between two readings aloud

const session = { hello: null, status: {}, scalar: "displacement", state: null, next: null, waiting: null, tool: null, sizes: {} };
const replaying = () => session.hello?.mode === "replay";
const driver = () => Boolean(session.status.driver) && !replaying();
const send = (message) => connection.send(message);

const page = {
  driver,
  send,
  tool: () => session.tool,
  drive() {
    if (replaying()) return;
    notices.toast("Someone else holds the tool.");
    byId("drive").focus();
  },
  posed: (sequence, stamp) => meter.posed(sequence, stamp),
  pressed(press) {
    if (press && session.status.state === "paused") notices.toast("Paused: the body does not answer.");
    if (!press) notices.speak("Released");
  },
};

let stage, hand, plots, panel, transport, connection;

function start() {
  try {
    stage = new Stage(byId("view"));
  } catch (error) {
    notices.connection("No picture", "bad");
    notices.stay(error.message);
    return;
  }
  plots = new Plots(byId);
  panel = new Panel(byId, { send, choose, change, scalar });
  transport = new Transport(byId, (message) => {
    if (message.action === "reset" && hand.press) hand.release();
    send(message);
  });
  hand = new Hand(stage, page);
  theme(byId("theme"), (accent, dark) => {
    stage.paint(accent, dark);
    plots.draw(performance.now(), true);
  });
  byId("drive").onclick = () => send({ type: "drive" });
  byId("help-open").onclick = () => byId("help").showModal();
  byId("overlay").onchange = () => {
    stage.overlay.lines.visible = byId("overlay").checked;
    stage.dirty = true;
  };
  addEventListener("keydown", key);
  addEventListener("keydown", () => (document.documentElement.dataset.by = "keys"), true);
  addEventListener("pointerdown", () => (document.documentElement.dataset.by = "pointer"), true);
  addEventListener("online", () => connection?.hurry());
  document.addEventListener("visibilitychange", () => document.hidden || connection?.hurry());
  const token = location.hash.slice(1);
  if (!token) {
    notices.connection("Not connected", "bad");
    notices.stay("Open the whole address that palpate view prints, with the part after #.");
  } else connection = new Connection(`ws://${location.host}/session`, token, { message, frame, lost, ended });
  let last = performance.now();
  requestAnimationFrame(function again(now) {
    requestAnimationFrame(again);
    picture(now, Math.max((now - last) / 1000, 0));
    last = now;
  });
  publish();
}

// from the server

const answers = {
  hello(message) {
    session.hello = message;
    session.status = { driver: false, viewers: message.viewers, state: "running", speed: 1 };
    session.sizes = firstSizes(message);
    byId("title").textContent = message.title;
    document.title = `${message.title} · palpate`;
    document.body.classList.toggle("replaying", replaying());
    const [low, high] = message.bounds;
    panel.offer(message, Math.hypot(...high.map((part, k) => part - low[k])));
    transport.offer(message);
    notices.stay(null);
    const names = ["none", ...message.scalars.map(({ name }) => name)];
    scalar(names.includes(session.scalar) ? session.scalar : "none");
    answers.status({ driver: message.driver, tool: message.tool });
  },
  status(message) {
    const before = driver();
    Object.assign(session.status, message);
    learn(message.tool);
    panel.materials(message.materials);
    if (driver() && !before && stage.organ) offerTool();
    showStatus();
  },
  statistics(message) {
    panel.statistics(message);
    // A hidden page draws no pictures. Without a word of it the server takes it for gone.
    if (session.next && session.next === session.waiting) send({ type: "ack", sequence: session.next.sequence });
    session.waiting = session.next;
  },
  error: ({ reason }) => notices.toast(reason, true),
  recorded: ({ file, frames }) => notices.toast(`${frames} frames recorded in ${file}`),
};

function message(received) {
  answers[received.type]?.(received);
}

function frame(received) {
  if (received.kind === 2) session.next = received;
  else if (received.kind === 1) {
    stage.take(received);
    if (driver()) offerTool();
    stage.overlay.lines.visible = byId("overlay").checked && session.hello.overlay;
  } else if (received.kind === 3) {
    stage.overlay?.update(received.positions);
    stage.dirty = true;
  }
}

function lost(seconds) {
  session.next = null;
  if (hand.press) hand.release();
  session.status.driver = false;
  notices.connection("Not connected", "bad");
  notices.stay(`The connection is gone. Trying again ${seconds < 1 ? "now" : `in ${Math.round(seconds)} s`} …`);
  byId("watching").hidden = true;
}

function ended(why) {
  notices.connection("Not connected", "bad");
  const reasons = {
    token: "This address has expired: open the one that palpate view printed last.",
    full: "Too many viewers: close another page, then load this one again.",
    refused: "The session refused this page.",
  };
  notices.stay(reasons[why]);
}

function showStatus() {
  const { status } = session;
  const viewers = status.viewers > 1 ? `, ${status.viewers} viewers` : "";
  const pause = { sleep: "after sleep", "closed tab": "nobody was there" }[status.paused_because] ?? status.paused_because;
  const why = pause ? `: ${pause}` : "";
  const rate = `Live at ${(session.hello.rate / 1000).toLocaleString("en")} kHz`;
  const names = { running: rate, paused: `Paused${why}`, stopped: "Stopped", "ran away": "Ran away: reset to go on" };
  const live = status.state === "running";
  notices.connection((replaying() ? "Replay" : names[status.state]) + viewers, live ? "live" : status.state === "ran away" ? "bad" : "");
  byId("watching").hidden = driver() || replaying();
  if (hand.press && !driver()) {
    hand.press = null;
    notices.toast("Someone else holds the tool now.");
  }
  panel.status({ tool: session.tool, driver: driver() }, replaying());
  transport.status(status, driver());
  stage.dirty = true;
}

// from the person

/** Sizes that suit the body, of each kind of tool. */
function firstSizes({ bounds: [low, high], spacing }) {
  const size = Math.hypot(...high.map((part, k) => part - low[k]));
  const round = (metres) => Math.max(Math.round(1e3 * metres), 1) / 1e3;
  const held = { friction: FRICTION, stiffness: COUPLING };
  return {
    sphere: { kind: "sphere", radius: round(0.075 * size), length: round(0.2 * size), ...held },
    capsule: { kind: "capsule", radius: round(0.04 * size), length: round(0.2 * size), ...held },
    grasp: { kind: "grasp", radius: round(Math.max(0.05 * size, 1.5 * (spacing ?? 0))), length: round(0.2 * size), ...held },
  };
}

/** Take over what the session says of the tool in the hand: whoever watches sees the driver's. */
function learn(tool) {
  const first = session.sizes[session.hello.tools[0]] ?? tool;
  if (tool && tool.kind !== "none" && (!driver() || tool.kind === "group")) session.tool = { ...tool };
  session.tool ??= { ...first };
}

function choose(kind) {
  if (kind === session.tool.kind || !driver()) return;
  if (hand.press) hand.release();
  session.sizes[session.tool.kind] = session.tool;
  session.tool = session.sizes[kind];
  offerTool();
}

/** Another size or coupling of the tool. */
function change(part) {
  if (hand.press) hand.release();
  session.tool = { ...session.tool, ...part };
  offerTool();
}

/** Tell the session of a tool that is put down: beside the body, and away. Forceps it learns of when they grasp. */
function offerTool() {
  const { tool } = session;
  const { sphere } = stage.organ;
  if (tool.kind === "sphere" || tool.kind === "capsule") {
    const far = sphere.radius + 2 * tool.radius + (tool.kind === "capsule" ? tool.length : 0);
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
  stage.organ?.colour(null);
  stage.dirty = true;
  send({ type: "show", scalar: name });
}

function key(event) {
  if (byId("help").open || event.ctrlKey || event.metaKey || event.altKey) return;
  const field = event.target.matches?.("input, select, button");
  if (field && [" ", "Enter", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"].includes(event.key)) return;
  const kinds = session.hello?.tools ?? [];
  const meanings = { r: () => transport.reset(), p: () => transport.pause(), f: () => stage.orbit.reset(), "?": () => byId("help").showModal() };
  const meaning = meanings[event.key.toLowerCase()] ?? (kinds[event.key - 1] && (() => choose(kinds[event.key - 1])));
  if (meaning) meaning();
  else if (!stage.organ || !hand.key(event)) return;
  event.preventDefault();
}

// each picture

function picture(now, seconds) {
  meter.presented(now);
  const state = session.next;
  const fresh = state !== null && stage.organ?.count * 3 === state.positions.length;
  session.next = null;
  if (fresh) take(state, now, seconds);
  if (stage.organ) {
    hand.tick(seconds, session.state);
    showTool(session.state);
  }
  if (stage.draw(seconds)) showScale(byId, stage.metresPerPixel());
  read(now);
  if (fresh) {
    meter.drawn(state);
    send({ type: "ack", sequence: state.sequence });
  }
  if (session.state?.state === "running" || replaying()) plots.draw(now);
  byId("view").classList.toggle("over", stage.ghost.group.visible || Boolean(hand.press));
}

function take(state, now, seconds) {
  session.state = state;
  stage.organ.update(state);
  stage.organ.colour(session.scalar === "none" ? null : legend.range(state, seconds));
  stage.dirty = true;
  if (state.state === "running") plots.add(now, state);
  transport.time(state.time);
  speak(state, now);
}

/** Tell the numbers, not more often than they can be read. */
let told = { at: 0, state: null };
function read(now) {
  if (!session.state || told.state === session.state || now - told.at < READ) return;
  told = { at: now, state: session.state };
  panel.state(session.state);
}

let spoken = 0;
function speak({ newtons }, now) {
  if (!hand.press || now - spoken < SPOKEN) return;
  spoken = now;
  notices.speak(`${(1e3 * hand.press.depth).toFixed(1)} millimetres, ${newtons.toFixed(2)} newtons`);
}

/** The driver's own tool is drawn where the hand is, unless a soft coupling lies between; others see the session's. */
function showTool(state) {
  const { tool: mark, arrow, size } = stage;
  const { tool } = session;
  const there = hand.press !== null || (state && state.tool !== "none");
  mark.group.visible = Boolean(there && tool && tool.kind !== "group" && size);
  arrow.group.visible = false;
  if (!there || !tool) return;
  const own = hand.press && (!tool.stiffness || state?.tool === "none");
  const [position, quaternion] = own ? [hand.press.position.toArray(), hand.press.quaternion] : [state.position, state.quaternion];
  mark.shape(tool, size);
  mark.at(position, quaternion);
  const ball = tool.kind === "sphere" || tool.kind === "capsule" ? tool.radius : 0;
  if (hand.press && !own) showHand(position, tool);
  if (state && state.tool !== "none") arrow.show(position, state.force, state.newtons, size, ball, tool.kind === "grasp");
}

/** Where the hand is, once a soft coupling has let it part from the tool. */
function showHand(position, tool) {
  const { ghost, size } = stage;
  const at = hand.press.position;
  ghost.group.visible = tool.kind !== "grasp" && at.distanceTo(new Vector3().fromArray(position)) > 0.004 * size;
  ghost.shape(tool, size);
  ghost.at(at.toArray(), hand.press.quaternion);
}

/** What tests and `palpate bench page` read. */
function publish() {
  window.palpate = {
    meter,
    notices,
    session,
    stage,
    get force() { return session.state?.newtons ?? 0; },
    get driver() { return driver(); },
    get viewers() { return session.status.viewers ?? 0; },
    get ready() { return session.state !== null; },
    project: (point) => stage.project(point),
  };
}

start();

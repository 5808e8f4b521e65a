// The settings with which each kind of tool begins.
import { deepestStroke } from "./bladeEdge.js";

const FRICTION = 0.2;
const COUPLING_STIFFNESS = 300; // [N/m], smooths the motion of a mouse
const DEPTH_SHARE = 0.3; // of the length of a blade, to which a press leads it

/** Initial sizes of each kind of tool, from the size of the body. */
export function initialTools({ bounds: [low, high], spacing, compare, least_radius: leastRadius = 0, tools, tool_parameters: parameters = {} }) {
  const size = Math.hypot(...high.map((part, k) => part - low[k]));
  const round = (metres) => Math.max(Math.round(1e3 * metres), 1) / 1e3;
  const least = Math.ceil(2e3 * leastRadius) / 2e3;
  const blade = Math.max(round(0.15 * size), 2 * least);
  const held = { friction: FRICTION, stiffness: compare ? null : COUPLING_STIFFNESS };
  const fitted = {
    sphere: { radius: Math.max(round(0.075 * size), least) },
    capsule: { radius: Math.max(round(0.04 * size), least), length: round(0.2 * size) },
    scalpel: { length: blade, depth: round(DEPTH_SHARE * blade) },
    grasp: { radius: round(Math.max(0.05 * size, 1.5 * (spacing ?? 0))) },
  };
  const usual = (kind) => Object.fromEntries((parameters[kind] ?? []).map(({ name, usual: value }) => [name, value]));
  return Object.fromEntries(tools.map((kind) => [kind, { kind, ...held, ...usual(kind), ...fitted[kind] }]));
}

/** Add the depth to which a press leads a blade: a setting of the page alone. */
export function offerDepth({ tool_parameters: parameters }) {
  const { scalpel } = parameters ?? {};
  if (scalpel && !scalpel.some(({ name }) => name === "depth")) scalpel.push({ name: "depth", unit: "m", low: 0, high: 1, usual: 0 });
}

/** A tool with a depth that its edge can cut; one without a depth as it is. */
export function withinEdge(tool) {
  return tool.depth === undefined ? tool : { ...tool, depth: Math.min(tool.depth, deepestStroke(tool.length)) };
}

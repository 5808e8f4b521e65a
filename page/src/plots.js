// Three strip charts of the last ten seconds; that of the forces has a line for each tool. Instead of it, the force over the depth.
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { PressCurve } from "./pressCurve.js";
import { choice } from "./widgets.js";

const DURATION = 10; // [s]
const REDRAW_INTERVAL = 100; // [ms]
const MORE_TOOLS = ["tool1", "tool2", "tool3"]; // columns of forces
const TOOL_LINES = ["--accent", "--tool-1", "--tool-2", "--tool-3"]; // by index
const DASHES = { "--tool-1": [7, 3], "--tool-2": [2, 3], "--tool-3": [7, 3, 2, 3] }; // told apart without colours, too
const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const FONT = '10px system-ui, "Liberation Sans", sans-serif';
const UNIT_GAP = 6; // [px] between an axis and its unit
const MIN_DEPTH_AXIS = 2; // [mm] at which the axis of the depth ends, at least

/** Write the units of a plot at the ends of its axes. */
function drawUnits({ ctx, bbox }, { x, y }) {
  const ratio = devicePixelRatio || 1;
  ctx.save();
  ctx.font = FONT.replace("10px", `${10 * ratio}px`);
  ctx.fillStyle = style("--quiet");
  ctx.textAlign = "left";
  const left = bbox.left + bbox.width + 5 * ratio;
  ctx.textBaseline = "top";
  ctx.fillText(x, left + 5 * ratio, bbox.top + bbox.height + 4 * ratio);
  ctx.textBaseline = "alphabetic";
  ctx.fillText(y, left, bbox.top - UNIT_GAP * ratio);
  ctx.restore();
}

class Strip {
  /**
   * `units` {x, y} are written at the axes; without them the axis x is hidden. `range` gives that of x from its data. `draw`
   * draws instead of the lines.
   */
  constructor(element, least, colours, fill, { units = null, range = () => [-DURATION, 0], draw } = {}) {
    this.element = element;
    this.columns = [[], ...colours.map(() => [])];
    const series = colours.map((name, k) => ({
      stroke: () => style(name),
      width: 1.5,
      dash: DASHES[name],
      points: { show: false },
      ...(draw && { paths: () => null }),
      ...(fill && k === 0 && { fill: () => `color-mix(in srgb, ${style(name)} 12%, transparent)` }),
    }));
    const axis = {
      side: 1, size: 30, gap: 5, font: FONT, ticks: { show: false },
      stroke: () => style("--faint"), grid: { stroke: () => style("--line"), width: 1 }, space: 26,
      values: (_, ticks) => ticks.map((tick) => Number(tick.toPrecision(4)).toString().replace("-", "−")),
    };
    const below = { ...axis, side: 2, size: 18, gap: 4, space: 40, grid: { show: false } };
    if (units) element.setAttribute("aria-label", `Force [${units.y}] over ${units.x === "s" ? "time" : "depth"} [${units.x}]`);
    const hooks = { draw: [(plot) => units && drawUnits(plot, units), ...(draw ? [draw] : [])] };
    this.plot = new uPlot({
      width: 200, height: 60, padding: units ? [16, 0, 0, 10] : [6, 0, 4, 0], hooks, cursor: { show: false }, legend: { show: false },
      scales: {
        x: { time: false, range },
        y: { range: (_, low, high) => [0, Math.max(least, 1.15 * (high ?? 0))] },
      },
      axes: [units ? below : { show: false }, axis],
      series: [{}, ...series],
    }, this.columns, element);
    new ResizeObserver(() => this.resize()).observe(element);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (width && height) this.plot.setSize({ width, height });
  }

  draw(times, values, now) {
    this.plot.setData([times.map((time) => (time - now) / 1000), ...values]);
  }
}

/** Draw a curve of points in order, with gaps where a force is not known, and a dot at its end. */
function drawCurve(plot, { depths, forces }) {
  const { ctx, bbox } = plot;
  const ratio = devicePixelRatio || 1;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top - 4 * ratio, bbox.width, bbox.height + 4 * ratio);
  ctx.clip();
  ctx.lineWidth = 1.5 * ratio;
  ctx.lineJoin = "round";
  ctx.strokeStyle = ctx.fillStyle = style("--accent");
  ctx.beginPath();
  const place = (k) => [plot.valToPos(depths[k], "x", true), plot.valToPos(forces[k], "y", true)];
  forces.forEach((newtons, k) => {
    if (newtons === null) return;
    if (k > 0 && forces[k - 1] !== null) ctx.lineTo(...place(k));
    else ctx.moveTo(...place(k));
  });
  ctx.stroke();
  if (Number.isFinite(forces.at(-1) ?? NaN)) {
    ctx.beginPath();
    ctx.arc(...place(forces.length - 1), 2.5 * ratio, 0, 2 * Math.PI);
    ctx.fill();
  }
  ctx.restore();
}

export class Plots {
  constructor(byId) {
    this.curve = new PressCurve();
    this.depthStrip = new Strip(byId("plot-depth"), 0.2, ["--accent"], false, {
      units: { x: "mm", y: "N" },
      range: (_, low, high) => [0, Math.max(MIN_DEPTH_AXIS, 1.1 * (high ?? 0))],
      draw: (plot) => drawCurve(plot, this.curve),
    });
    const mark = choice(byId("plot-kind"), [["time", "over time"], ["depth", "over depth"]], (kind) => this.show(kind));
    this.mark = (kind) => {
      this.kind = kind;
      mark(kind);
      byId("plot-force").hidden = kind !== "time";
      byId("plot-depth").hidden = kind !== "depth";
    };
    this.mark("time");
    this.nameDepth = (text) => (byId("plot-kind").lastElementChild.textContent = text);
    this.offerDepth = (offered) => {
      byId("plot-kind").hidden = !offered;
      if (!offered) this.mark("time");
    };
    this.strips = [
      [new Strip(byId("plot-force"), 0.5, [TOOL_LINES[0], "--faint", ...TOOL_LINES.slice(1)], true, { units: { x: "s", y: "N" } }), ["newtons", "fullNewtons", ...MORE_TOOLS]],
      [new Strip(byId("plot-energy"), 0.1, ["--accent", "--faint"], false), ["strain", "kinetic"]],
      [new Strip(byId("plot-step"), 0.1, ["--accent"], false), ["computing"]],
    ];
    this.times = [];
    this.values = Object.fromEntries(["newtons", "fullNewtons", ...MORE_TOOLS, "strain", "kinetic", "computing"].map((name) => [name, []]));
    this.last = 0;
  }

  /** Add a state, and the states of all tools by index. */
  add(now, state, beyond, fullNewtons, tools) {
    if (now - (this.times.at(-1) ?? -Infinity) < 15) return;
    this.times.push(now);
    const gap = beyond && !Number.isFinite(fullNewtons); // where a model was not trained, and nothing is compared
    this.values.newtons.push(gap ? null : state.newtons);
    MORE_TOOLS.forEach((name, k) => {
      const tool = tools[k + 1];
      this.values[name].push(gap || !tool || tool.kind === "none" ? null : tool.newtons);
    });
    this.values.fullNewtons.push(Number.isFinite(fullNewtons) ? fullNewtons : null);
    this.values.strain.push(1e3 * state.strain);
    this.values.kinetic.push(1e3 * state.kinetic);
    this.values.computing.push(1e3 * state.computing);
    const old = this.times.findIndex((time) => time > now - 1000 * DURATION - 200);
    if (old < 60) return; // removed in batches
    this.times.splice(0, old);
    for (const column of Object.values(this.values)) column.splice(0, old);
  }

  draw(now, again = false) {
    if (!again && now - this.last < REDRAW_INTERVAL) return;
    this.last = now;
    const shown = this.kind === "time" ? this.strips : this.strips.slice(1);
    for (const [strip, names] of shown) strip.draw(this.times, names.map((name) => this.values[name]), now);
    if (this.kind === "time") return;
    const { depths, forces } = this.curve;
    const most = (list) => list.reduce((high, value) => Math.max(high, value ?? 0), 0);
    this.depthStrip.plot.setData([[0, most(depths)], [0, most(forces)]]);
  }

  /** Offer the force over the depth where a tool of a hello message has one, or over the displacement of an end. */
  offer({ mode, tools, end = null }) {
    this.offerDepth(mode !== "replay" && (end !== null || tools.some((kind) => kind === "sphere" || kind === "capsule")));
    this.nameDepth(end ? "over displacement" : "over depth");
  }

  /** Show the force over "time" or over "depth". */
  show(kind) {
    this.mark(kind);
    this.draw(performance.now(), true);
  }

  clear() {
    this.times.length = 0;
    this.curve.clear();
    for (const column of Object.values(this.values)) column.length = 0;
  }
}

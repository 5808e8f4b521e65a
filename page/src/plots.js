// Three strip charts of the last ten seconds; that of the forces has a line for each tool.
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";

const DURATION = 10; // [s]
const REDRAW_INTERVAL = 100; // [ms]
const MORE_TOOLS = ["tool1", "tool2", "tool3"]; // columns of forces
const TOOL_LINES = ["--accent", "--tool-1", "--tool-2", "--tool-3"]; // by index
const DASHES = { "--tool-1": [7, 3], "--tool-2": [2, 3], "--tool-3": [7, 3, 2, 3] }; // told apart without colours, too
const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

class Strip {
  constructor(element, least, colours, fill) {
    this.element = element;
    this.columns = [[], ...colours.map(() => [])];
    const series = colours.map((name, k) => ({
      stroke: () => style(name),
      width: 1.5,
      dash: DASHES[name],
      points: { show: false },
      ...(fill && k === 0 && { fill: () => `color-mix(in srgb, ${style(name)} 12%, transparent)` }),
    }));
    const axis = {
      side: 1, size: 30, gap: 5, font: '10px system-ui, "Liberation Sans", sans-serif', ticks: { show: false },
      stroke: () => style("--faint"), grid: { stroke: () => style("--line"), width: 1 }, space: 26,
      values: (_, ticks) => ticks.map((tick) => Number(tick.toPrecision(4)).toString()),
    };
    this.plot = new uPlot({
      width: 200, height: 60, padding: [6, 0, 4, 0], cursor: { show: false }, legend: { show: false },
      scales: {
        x: { time: false, range: () => [-DURATION, 0] },
        y: { range: (_, low, high) => [0, Math.max(least, 1.15 * (high ?? 0))] },
      },
      axes: [{ show: false }, axis],
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

export class Plots {
  constructor(byId) {
    this.strips = [
      [new Strip(byId("plot-force"), 0.5, [TOOL_LINES[0], "--faint", ...TOOL_LINES.slice(1)], true), ["newtons", "fullNewtons", ...MORE_TOOLS]],
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
    for (const [strip, names] of this.strips) strip.draw(this.times, names.map((name) => this.values[name]), now);
  }

  clear() {
    this.times.length = 0;
    for (const column of Object.values(this.values)) column.length = 0;
  }
}

// Frame rate and latency of the page.

const MAX_SAMPLES = 4096;

/** Measures the rate of frames with a new state, and the latency from pointer events to the frames that show them. */
export class FrameMeter {
  constructor() {
    Object.assign(this, { frames: [], latencies: [], sentPoses: new Map(), pending: null });
  }

  poseSent(sequence, stamp) {
    if (stamp !== null && stamp !== undefined) this.sentPoses.set(sequence, stamp);
  }

  /** Add a rendered state; `framePresented` follows with the next frame. */
  stateRendered(state) {
    this.pending = state;
  }

  framePresented(now) {
    if (!this.pending) return;
    addSample(this.frames, now);
    for (const [sequence, stamp] of this.sentPoses) {
      if (sequence > this.pending.pose) break;
      this.sentPoses.delete(sequence);
      addSample(this.latencies, now - stamp);
    }
    this.pending = null;
  }

  reset() {
    this.frames.length = this.latencies.length = 0;
    this.sentPoses.clear();
  }

  summary() {
    const [first, last] = [this.frames[0], this.frames.at(-1)];
    const sorted = [...this.latencies].sort((a, b) => a - b);
    const at = (share) => (sorted.length ? sorted[Math.ceil(share * sorted.length) - 1] : null);
    return {
      frames: this.frames.length,
      rate: this.frames.length > 1 ? (1000 * (this.frames.length - 1)) / (last - first) : 0,
      latencies: sorted.length,
      median: at(0.5),
      p95: at(0.95),
    };
  }
}

function addSample(list, item) {
  list.push(item);
  if (list.length > MAX_SAMPLES) list.splice(0, MAX_SAMPLES / 2);
}

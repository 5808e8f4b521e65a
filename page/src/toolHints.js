// One hint at the first choice of each tool: what a hand does with it. Its use dismisses it, for good.

const KEY = "palpate-hints";
const NARROW = "(max-width: 720px)"; // where the panel is below the body
const PRESS = { name: "press", mouse: "Hold on the body and drag down: the tool presses deeper.", touch: "Hold a finger on the body and drag down: the tool presses deeper.", keys: "Arrow keys choose the place, + presses deeper, space lets go." };
const PULL = { name: "pull", mouse: "Hold on the body and drag: the forceps pull. H leaves them there.", touch: "Hold a finger on the body and drag: the forceps pull. “Hold here” leaves them there.", keys: "Arrow keys choose the place, + grasps, arrow keys pull. H leaves the forceps there." };
const CUT = { name: "cut", mouse: "Hold on the body and draw: the blade cuts. Ctrl+Z undoes it.", touch: "Hold a finger on the body and draw: the blade cuts. The arrow next to Reset undoes it.", keys: "Arrow keys choose the place, + lowers the blade, arrow keys draw it. Ctrl+Z undoes the cut." };
const HINTS = { sphere: PRESS, capsule: PRESS, grasp: PULL, scalpel: CUT };

/** Read the names of the hints whose tools were used. */
function usedBefore() {
  try {
    const kept = JSON.parse(localStorage.getItem(KEY) ?? "[]");
    return new Set(Array.isArray(kept) ? kept : []);
  } catch {
    return new Set();
  }
}

/** The hint for a kind of tool and a way to use it ("mouse", "touch" or "keys"); empty without one, and for one that is used. */
export function hintText(kind, way, used) {
  const hint = HINTS[kind];
  return hint && !used.has(hint.name) ? hint[way] : "";
}

export class ToolHints {
  /** `element` shows the hint among the messages, and on a phone in the panel, before the `sizes` of a tool. A still picture has none. */
  constructor(element, sizes) {
    Object.assign(this, { element, used: usedBefore(), silent: new URLSearchParams(location.search).has("still") });
    const [messages, narrow] = [element.parentElement, matchMedia(NARROW)];
    const place = () => (narrow.matches ? sizes.before(element) : messages.append(element));
    narrow.addEventListener("change", place);
    place();
    this.way = matchMedia("(pointer: coarse)").matches ? "touch" : "mouse";
    addEventListener("keydown", () => this.take("keys"), true);
    for (const name of ["pointerdown", "pointermove"]) {
      addEventListener(name, ({ pointerType }) => this.take(pointerType === "touch" ? "touch" : "mouse"), true);
    }
  }

  take(way) {
    if (way === this.way) return;
    this.way = way;
    this.update();
  }

  /** Show the hint of a kind of tool that is in hand; none for null. */
  show(kind) {
    this.kind = kind;
    this.update();
  }

  update() {
    const text = this.silent ? "" : hintText(this.kind, this.way, this.used);
    if (this.element.textContent !== text) this.element.textContent = text;
  }

  /** Remember that a kind of tool was used. */
  use(kind) {
    const hint = HINTS[kind];
    if (!hint || this.used.has(hint.name)) return;
    this.used.add(hint.name);
    try {
      localStorage.setItem(KEY, JSON.stringify([...this.used]));
    } catch {
      // a browser that keeps nothing shows the hint again next time
    }
    this.update();
  }
}

// The room of the title: messages stand below it where they would cover it.

const GAP = 12; // [px]
const USUAL_TOP = 24; // [px] of messages next to a title

/** The top [px] of messages next to a title, or below it where the two would overlap. */
export function messagesTop(title, messages, usual) {
  const isClear = title.right + GAP <= messages.left;
  return isClear ? usual : Math.max(usual, title.bottom + GAP);
}

/** Keep messages clear of the title, whatever it says and however wide the window is. */
export function placeMessages(byId) {
  const [scene, title, messages] = [byId("scene"), ...[".title", ".messages"].map((name) => document.querySelector(name))];
  const place = () => {
    const { top } = scene.getBoundingClientRect();
    const box = title.getBoundingClientRect();
    messages.classList.remove("below");
    const next = messagesTop({ right: box.right, bottom: box.bottom - top }, messages.getBoundingClientRect(), USUAL_TOP);
    messages.classList.toggle("below", next !== USUAL_TOP);
    messages.style.top = `${Math.round(next)}px`;
  };
  const watch = new ResizeObserver(place);
  for (const element of [scene, title]) watch.observe(element);
}

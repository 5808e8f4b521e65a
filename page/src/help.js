// Help that lists only what the present page has.
import { nameOf } from "./hands.js";

/** What a page has, by the words that rows of the help need. */
export function helpFacts({ mode, tools = [], max_tools: most = 1 }, surroundings) {
  const live = mode !== "replay";
  const has = (...kinds) => live && kinds.some((kind) => tools.includes(kind));
  const group = live && tools.length === 0;
  return {
    live, replay: !live, surroundings,
    press: has("sphere", "capsule"), pull: has("grasp") || group, group, cut: has("scalpel"),
    depth: has("sphere", "capsule", "scalpel"), choice: live && tools.length > 1, several: live && most > 1,
    fingers: live && most > 1 && tools.length > 0,
  };
}

/** Open the help for a page whose session said hello; before that, it lists what every page has. */
export function openHelp(byId, hello, surroundings) {
  const facts = helpFacts(hello ?? { mode: "replay" }, surroundings);
  for (const row of byId("help").querySelectorAll("[data-needs]")) row.hidden = !row.dataset.needs.split(" ").some((need) => facts[need]);
  const kinds = facts.choice ? hello.tools : [];
  byId("help-kinds").replaceChildren(...kinds.map((_, k) => Object.assign(document.createElement("kbd"), { textContent: k + 1 })));
  byId("help-kind-names").textContent = kinds.map(nameOf).join(", ");
  byId("help").showModal();
}

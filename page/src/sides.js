// Sides of a patient in a view: letters at the ends of a horizontal line.

const MIN_SHARE = Math.sin(Math.PI / 8); // of a direction along an axis, from which its letter is written

/** Letters towards plus and minus of the axes of a frame that states how the patient lies. */
const LETTERS = { LPS: ["LR", "PA", "SI"], RAS: ["RL", "AP", "SI"] };
const WORDS = { L: "left", R: "right", A: "front", P: "rear", S: "head", I: "feet" };

/** Letters at the left and the right end of a line on the screen with a direction [3] in a frame; null in another frame. */
export function sideLetters(space, direction) {
  const letters = LETTERS[space];
  if (!letters) return null;
  const axes = [0, 1, 2].filter((k) => Math.abs(direction[k]) > MIN_SHARE).sort((a, b) => Math.abs(direction[b]) - Math.abs(direction[a]));
  const end = (sign) => axes.map((k) => letters[k][sign * direction[k] > 0 ? 0 : 1]).join("");
  return [end(-1), end(1)];
}

/** Letters in words, such as "right" or "front, left". */
export const sideWords = (letters) => [...letters].map((letter) => WORDS[letter]).join(", ");

// What of a sentence the bundle was never shown, with what is near, and what it could not honour.
import { element } from "./elements.js";

const REASONS = { combination: "known words, but not in this use", people: "more than one person" };

function line({ text, nearest, reason }) {
  const made = element("p", { class: "unknown" }, "Not known: ", element("mark", {}, text));
  if (REASONS[reason]) made.append(` (${REASONS[reason]})`);
  if (nearest.length) made.append("; near: ", nearest.map((phrase) => `\u201c${phrase}\u201d`).join(", "));
  return made;
}

/** Show both of a clip, or of a sentence, in a box; it is hidden where there is nothing to tell. */
export function tell(box, { unknown = [], notes = [] }) {
  box.replaceChildren(...unknown.map(line), ...notes.map((note) => element("p", { class: "note" }, note)));
  box.hidden = !box.childElementCount;
}

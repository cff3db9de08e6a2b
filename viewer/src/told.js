// What of a sentence the bundle was never shown, with what is near, and what it could not honour.
import { element } from "./elements.js";

const REASONS = { combination: "known words, but not in this use", people: "more than one person" };

/** use(words, phrase) puts a known phrase in place of unknown words; without it phrases are only named. */
function line({ text, nearest, reason }, use) {
  const made = element("p", { class: "unknown" }, "Not known: ", element("mark", {}, text));
  if (REASONS[reason]) made.append(` (${REASONS[reason]})`);
  if (!nearest.length) return made;
  const near = (phrase) => {
    const quoted = `\u201c${phrase}\u201d`;
    if (!use) return quoted;
    return element("button", { type: "button", class: "near", title: `Say it in place of ${text}`, onclick: () => use(text, phrase) }, quoted);
  };
  made.append("; near: ", ...nearest.flatMap((phrase, at) => (at ? [", ", near(phrase)] : [near(phrase)])));
  return made;
}

/** Show both of a clip, or of a sentence, in a box; it is hidden where there is nothing to tell. */
export function tell(box, { unknown = [], notes = [] }, use = null) {
  box.replaceChildren(...unknown.map((words) => line(words, use)), ...notes.map((note) => element("p", { class: "note" }, note)));
  box.hidden = !box.childElementCount;
}

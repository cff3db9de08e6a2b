// Below the sentence: examples to press, a search over all that is known, and unknown words in yellow where they stand.
import { element } from "./elements.js";
import { chosen, isSeldom, recognised, said, search, shortOf } from "./phrases.js";

const ACTIONS = 9;
const STYLES = 6;

/** play(sentence) makes a clip of it. */
export function createWords(box, text, phrases, play) {
  const [rows, field, found] = [".chip-rows", ".search", ".found"].map((name) => box.querySelector(name));
  box.hidden = !phrases.length;

  const chip = (phrase, ...beside) =>
    element(
      "button",
      { type: "button", class: `chip ${phrase.kind}`, title: phrase.example, onclick: () => play(said(text.value, phrase, phrases)) },
      shortOf(phrase),
      ...beside,
    );
  const hit = (phrase) => {
    const share = recognised(phrase);
    if (!share) return chip(phrase);
    const told = `recognised in ${share} of its clips`;
    const button = chip(phrase, element("small", {}, share));
    button.classList.toggle("seldom", isSeldom(phrase));
    button.title = `${phrase.example}: ${told}`;
    button.setAttribute("aria-label", `${shortOf(phrase)}, ${told}`);
    return button;
  };
  const row = (name, kind, most) =>
    element("div", { class: "chips", role: "group", "aria-label": name }, element("span", { class: "kind" }, name), ...chosen(phrases, kind, most).map((phrase) => chip(phrase)));
  rows.append(row("Actions", "action", ACTIONS), row("Styles", "style", STYLES));
  field.placeholder = `Search all ${phrases.length}`;

  field.addEventListener("input", () => {
    const query = field.value.trim();
    const hits = search(phrases, query);
    rows.hidden = Boolean(query);
    found.replaceChildren(...hits.map(hit));
    if (query && !hits.length) found.append(element("p", { class: "hint" }, "Nothing like that was shown to this model."));
  });
  field.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault(); // it is not the form's Enter
    found.querySelector("button")?.click();
  });
  return { search: () => field.focus() };
}

/** Unknown words in yellow where they stand: the same text behind the field, whose own ground is clear. */
export function createMarks(text, behind) {
  let words = [];
  function draw() {
    const parts = [];
    let rest = text.value;
    for (const word of words) {
      const at = rest.toLowerCase().indexOf(word.toLowerCase());
      if (at < 0) continue;
      parts.push(rest.slice(0, at), element("mark", {}, rest.slice(at, at + word.length)));
      rest = rest.slice(at + word.length);
    }
    behind.replaceChildren(...parts, rest, "\u200b");
    behind.scrollTop = text.scrollTop;
  }
  for (const kind of ["input", "scroll"]) text.addEventListener(kind, draw);
  return {
    show(unknown) {
      words = unknown.map((found) => found.text);
      draw();
    },
  };
}

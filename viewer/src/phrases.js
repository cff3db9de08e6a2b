// What a bundle was shown: actions and styles, chosen, searched, and put into a sentence.
const LONGEST = 26; // characters of what is offered without a search
const OFTEN = 0.5; // share of its clips in which an action is recognised, that counts as mostly
const PERSON = /^an? person /;

/** "a person raises the left hand" -> "raises the left hand"; "a person walks angrily" -> "angrily". */
export const shortOf = ({ kind, example, wordings }) => (kind === "style" ? wordings[0] ?? example : example.replace(PERSON, ""));

/** How often an action is recognised in its own clips, "83 %"; "" where nobody measured it. */
export const recognised = (phrase) => (phrase.recognised == null ? "" : `${Math.round(100 * phrase.recognised)} %`);

/** Whether an action is recognised in less than half of its clips. */
export const isSeldom = ({ recognised: share }) => share != null && share < OFTEN;

/** What is mostly recognised first, then what was not measured, then the rest; of these the most shown first. */
function better(a, b) {
  const rank = (phrase) => (phrase.recognised == null ? 1 : isSeldom(phrase) ? 0 : 2);
  return rank(b) - rank(a) || b.clips - a.clips;
}

/** The best action of each verb, so that few of them show much; or the best styles, but for the plain one. */
export function chosen(phrases, kind, most) {
  const seen = new Set();
  return phrases
    .filter((phrase) => phrase.kind === kind && !/^in a normal way$/.test(phrase.wordings[0]))
    .sort(better)
    .filter((phrase) => {
      const verb = kind === "style" ? phrase.example : shortOf(phrase).replace(/^is /, "").match(/[\p{L}]+/u)?.[0];
      return shortOf(phrase).length <= LONGEST && !seen.has(verb) && seen.add(verb);
    })
    .slice(0, most);
}

/** Phrases in which every word of a query begins a word, the best first. */
export function search(phrases, query, most = 24) {
  const begun = query.toLowerCase().match(/[\p{L}\p{N}]+/gu) ?? [];
  if (!begun.length) return [];
  const has = (text) => {
    const words = text.toLowerCase().match(/[\p{L}\p{N}]+/gu) ?? [];
    return begun.every((start) => words.some((word) => word.startsWith(start)));
  };
  return phrases
    .filter(({ example, wordings }) => [example, ...wordings].some(has))
    .sort(better)
    .slice(0, most);
}

/** A sentence with a phrase: an action is a sentence of its own, a style goes behind the sentence, in place of another. */
export function said(sentence, phrase, phrases) {
  if (phrase.kind === "action") return phrase.example;
  const style = shortOf(phrase);
  const plain = sentence.trim().replace(/[.!]$/, "") || "a person walks";
  const others = phrases.filter(({ kind }) => kind === "style").flatMap(({ wordings }) => wordings);
  const worn = others.sort((a, b) => b.length - a.length).find((wording) => plain.endsWith(` ${wording}`));
  return `${worn ? plain.slice(0, -worn.length - 1) : plain} ${style}`;
}

/** A sentence with known words in place of unknown ones. */
export function replaced(sentence, unknown, known) {
  const at = sentence.toLowerCase().indexOf(unknown.toLowerCase());
  return at < 0 ? `a person ${known}` : sentence.slice(0, at) + known + sentence.slice(at + unknown.length);
}

// The graph of the sentence in the box: parsed while one types, edited by the server, weighed here.
import * as api from "./api.js";
import { drawGraph, isPlain, withWeight } from "./graph.js";
import { replaced } from "./phrases.js";
import { tell } from "./told.js";

const PAUSE = 350; // milliseconds without a key before a sentence is parsed

/** on: {again(), fail(error), marks(unknown)}; marks shows unknown words where they stand. */
export function createGraphEditor(side, text, play, { again, fail, marks }) {
  const [section, box, reset, told] = [".graph-box", ".graph", ".as-parsed", "#told"].map((name) => side.querySelector(name));
  let graph = null;
  let source = null; // the sentence that the graph belongs to
  let edited = false;
  let shown = true;
  let timer = 0;
  let asked = null;
  let editing = false; // an edit is with the server: numbers of nodes are about to change

  const current = () => graph !== null && source === text.value.trim();

  function set(found, changed) {
    graph = found;
    source = text.value.trim();
    edited = changed;
    reset.hidden = !edited;
    section.hidden = !shown || !graph;
    if (graph) drawGraph(box, graph, source, { weigh, change, roles: play.roles });
    look(graph);
  }

  /** Tell under the sentence what the bundle does not know of it. */
  async function look(own) {
    const answer = own ? await api.unknown(own).catch(() => ({})) : {};
    if (own !== graph) return;
    tell(told, answer, say);
    marks(answer.unknown ?? []);
  }

  /** Put a known phrase in place of unknown words. */
  function say(words, phrase) {
    text.value = replaced(text.value, words, phrase);
    text.focus();
    parse();
  }

  function weigh(number, weight) {
    if (!current() || editing) return; // what is drawn belongs to other words, or is about to change
    graph = withWeight(graph, number, weight);
    edited = true;
    reset.hidden = false;
    again();
  }

  async function change(edit) {
    if (!current() || editing) return;
    const own = graph;
    editing = true;
    try {
      const found = await api.edit(own, edit);
      if (graph !== own || !current()) return; // other words by now
      set(found, true);
      focus(edit);
      fail(null);
      again();
    } catch (error) {
      fail(error);
    } finally {
      editing = false;
    }
  }

  /** Where the keyboard goes on after an edit, as its own button is drawn anew. */
  function focus({ kind, node }) {
    const adding = { action: "action", argument: node }[kind];
    const near = Math.min(node, box.querySelectorAll("[data-node]").length);
    box.querySelector(adding ? `[data-add="${adding}"]` : `[data-node="${near}"]`).focus();
  }

  async function parse() {
    clearTimeout(timer);
    asked?.abort();
    const sentence = text.value.trim();
    if (!sentence) return set(null, false);
    const own = (asked = new AbortController());
    try {
      const found = await api.parse(sentence, own.signal);
      if (text.value.trim() === sentence) set(found, false);
      fail(null);
    } catch (error) {
      if (error.name !== "AbortError") fail(error);
    }
  }

  text.addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(parse, PAUSE);
  });
  reset.addEventListener("click", async () => {
    await parse();
    again();
  });

  return {
    /** The sentence, or its graph where that has been edited. */
    wish: () => (current() && edited ? { text: source, graph } : { text: text.value.trim() }),
    /** What the server made of the sentence, unless there is a graph of it already. */
    parsed(found, asking) {
      clearTimeout(timer);
      if (!current() && asking.text === text.value.trim()) set(found, !isPlain(found));
    },
    /** The segment of a project whose text stands in the box already; its graph, or `known`, or else it is parsed. */
    load(segment, known) {
      clearTimeout(timer);
      asked?.abort();
      if (segment.graph) set(segment.graph, true);
      else if (known && isPlain(known)) set(known, false);
      else if (!current() || edited) parse();
    },
    visible(is) {
      shown = is;
      section.hidden = !shown || !graph;
    },
  };
}

// What stands beside clips that are in the page: caption, facts, graph.
import { element } from "./elements.js";
import { drawGraph, nodesOf } from "./graph.js";
import { tell } from "./told.js";

/** "4.0 s, 80 frames at 20 per second, seed 7, edge 0.2.0". */
export function facts(clip) {
  const seconds = (clip.frames / clip.fps).toFixed(1);
  return `${seconds} s, ${clip.frames} frames at ${clip.fps} per second, seed ${clip.seed}, ${clip.bundle}`;
}

/** Which of so many sentences were made anew (from 0), and which are as they were; "" where there is nothing to tell. */
export function madeOf(made, count) {
  if (!made || count < 2) return "";
  if (!made.length) return "nothing had to be made anew";
  if (made.length === count) return "all sentences made anew";
  return `made anew: sentence ${made.map((at) => at + 1).join(", ")} of ${count}`;
}

/** A name for the files of a clip, of its words and seed: "a_person_walks_forward_7". */
export function fileName(clip) {
  const words = clip.text.toLowerCase().match(/[\p{L}\p{N}]+/gu) ?? ["clip"];
  const kept = words.filter((_, index) => words.slice(0, index + 1).join("_").length <= 60);
  return [...(kept.length ? kept : ["clip"]), clip.seed].join("_");
}

/** What a clip was made of, in a line that tells it from others: its sentence, weights, negations, method and seed. */
export function named(clip, { graph, concepts, method, lambdas, agd }) {
  const parts = concepts ?? (graph ? nodesOf(graph) : []);
  const weighed = parts.filter(({ weight }) => weight !== 1);
  const said = weighed.map(({ text, weight }) => (weight < 0 ? `not ${text} ×${-weight}` : `${text} ×${weight}`));
  if (concepts && method && method !== "auto") said.push(method);
  if (lambdas) said.push(`shares ${lambdas}`);
  if (agd) said.push(`AGD ${agd}`);
  return [clip.text, ...said, `seed ${clip.seed}`].join(", ");
}

export function describeClips(side, clips) {
  side.append(element("header", {}, element("h1", {}, "kinegraph")));
  for (const clip of clips) {
    const box = element("section", { class: "clip" }, element("h2", {}, clip.text), element("p", { class: "facts" }, facts(clip)));
    const told = element("div", { class: "told" });
    tell(told, clip);
    box.append(told);
    if (clip.graph) {
      const graph = element("div", { class: "graph" });
      drawGraph(graph, clip.graph, clip.text);
      box.append(graph);
    }
    side.append(box);
  }
}

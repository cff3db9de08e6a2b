// Concepts over spans of a timeline, as plain values: {text, begin, end, weight}, seconds. Nothing here is drawn.
import { rounded } from "./project.js";

export const SHORTEST_LAYER = 0.3; // seconds
export const MOST_LAYERS = 16;
const TOUCHES = 0.1; // seconds that a span covers of a sentence to count for it, as kinegraph.layers has it

/** The layer inside a timeline of so many seconds, and not too short. */
export function layered(layer, whole) {
  const begin = rounded(Math.min(Math.max(layer.begin, 0), Math.max(whole - SHORTEST_LAYER, 0)));
  return { ...layer, begin, end: rounded(Math.max(Math.min(layer.end, whole), Math.min(begin + SHORTEST_LAYER, whole))) };
}

/** The layer with its begin, its end, or both, so many seconds later; both keep its length. */
export function layerAt(layer, kind, by, whole = Infinity) {
  if (kind === "both") {
    const shift = Math.min(Math.max(by, -layer.begin), whole - layer.end);
    return { ...layer, begin: layer.begin + shift, end: layer.end + shift };
  }
  if (kind === "begin") return { ...layer, begin: Math.min(layer.begin + by, layer.end - SHORTEST_LAYER) };
  return { ...layer, end: Math.max(layer.end + by, layer.begin + SHORTEST_LAYER) };
}

/** Whether a layer counts for a sentence. */
export function touches({ begin, end }, from, to) {
  return Math.min(end, to) - Math.max(begin, from) >= Math.min(TOUCHES, (end - begin) / 2) - 1e-9;
}

/** From when to when a layer counts: the whole of all sentences that it touches. */
export function reach(layer, edges) {
  const touched = edges.slice(1).map((to, at) => [edges[at], to]).filter(([from, to]) => touches(layer, from, to));
  return touched.length ? [touched[0][0], touched.at(-1)[1]] : [layer.begin, layer.end];
}

/** Layers that still fit a timeline; those behind its end are gone. */
export const fittedLayers = (layers, whole) => layers.filter(({ begin }) => begin < whole - SHORTEST_LAYER / 2).map((layer) => layered(layer, whole));

/** "waves the right hand", "not waves the right hand", "waves ×0.5". */
export function said({ text, weight }) {
  const short = text.replace(/^an? person /, "");
  const size = Math.abs(weight) === 1 ? "" : ` ×${Math.abs(weight)}`;
  return `${weight < 0 ? "not " : ""}${short}${size}`;
}

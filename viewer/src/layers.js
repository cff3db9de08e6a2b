// Concepts over spans of the timeline: a bar for each, to drag, stretch, weigh and delete. A sentence is made at once, so a
// bar counts for the whole of every sentence that it touches; that is drawn behind it.
import { element } from "./elements.js";
import { layerAt, layered, reach, said, SHORTEST_LAYER } from "./layering.js";

const NUDGE = 0.1; // seconds per key
const DRAG = 4; // pixels before a press is a drag
const LIMIT = 2; // of a weight
const EXACT = 0.05; // seconds by which a concept may count for more than its span, without a word about it
const NEW = "a person waves the right hand";

/**
 * @param box the timeline, with `.layers`, `.inspector.layer` and `.add-layer`
 * @param on {change(layers), selected() one of them, now() seconds, cut(layer) sentences where it begins and ends, canCut(layer)}
 */
export function createLayers(box, on) {
  const [tracks, inspector, add] = [".layers", ".inspector.layer", ".add-layer"].map((name) => box.querySelector(name));
  let layers = [];
  let edges = [0, 1];
  let selected = -1;
  const whole = () => edges.at(-1) || 1;
  const share = (seconds) => `${(100 * seconds) / whole()}%`;
  const set = (at, layer) => on.change(layers.with(at, layered(layer, whole())));

  function remove(at) {
    selected = -1;
    on.change(layers.toSpliced(at, 1));
    (tracks.querySelector("button") ?? add).focus();
  }

  function cut(at) {
    tracks.querySelectorAll("button")[at].focus(); // what is written in the inspector is not drawn anew
    on.cut(layers[at]);
  }

  const isWider = (layer, from, to) => from < layer.begin - EXACT || to > layer.end + EXACT;

  function bar(layer, at) {
    const [from, to] = reach(layer, edges);
    const counts = isWider(layer, from, to) ? `; counts from ${from.toFixed(1)} to ${to.toFixed(1)} s` : "";
    const when = `from ${layer.begin.toFixed(1)} to ${layer.end.toFixed(1)} s`;
    const button = element(
      "button",
      { type: "button", class: `bar-of${layer.weight < 0 ? " not" : ""}`, "aria-pressed": String(at === selected), "aria-label": `${said(layer)} ${when}${counts}`, title: `${said(layer)} ${when}${counts}` },
      said(layer),
    );
    const ground = element("i", { class: "reach" });
    Object.assign(ground.style, { left: share(from), width: share(to - from) });
    Object.assign(button.style, { left: share(layer.begin), width: share(layer.end - layer.begin) });
    button.addEventListener("click", () => select(at));
    button.addEventListener("keydown", (event) => pressed(event, at));
    button.addEventListener("pointerdown", (event) => drag(event, button, at));
    return element("div", { class: "track" }, ground, button);
  }

  /** Near an end it is stretched, else moved. */
  function drag(event, button, at) {
    if (event.button) return;
    const { left, right } = button.getBoundingClientRect();
    const grip = Math.min(10, (right - left) / 4);
    const kind = event.clientX > right - grip ? "end" : event.clientX < left + grip ? "begin" : "both";
    const scale = whole() / tracks.clientWidth;
    let moved = null;
    button.setPointerCapture(event.pointerId);
    const onmove = (now) => {
      const far = now.clientX - event.clientX;
      if (!moved && Math.abs(far) < DRAG) return;
      moved = layered(layerAt(layers[at], kind, far * scale, whole()), whole());
      Object.assign(button.style, { left: share(moved.begin), width: share(moved.end - moved.begin) });
    };
    const onend = (now) => {
      button.removeEventListener("pointermove", onmove);
      for (const name of ["pointerup", "pointercancel"]) button.removeEventListener(name, onend);
      if (moved && now.type === "pointerup") set(at, moved);
      else if (moved) draw();
    };
    button.addEventListener("pointermove", onmove);
    for (const name of ["pointerup", "pointercancel"]) button.addEventListener(name, onend);
  }

  function pressed(event, at) {
    const by = { ArrowLeft: -NUDGE, ArrowRight: NUDGE }[event.key];
    if (event.key === "Delete" || event.key === "Backspace") remove(at);
    else if (by) set(at, layerAt(layers[at], event.shiftKey ? "end" : "both", by, whole()));
    else return;
    event.preventDefault();
  }

  function inspect() {
    const layer = layers[selected];
    inspector.hidden = !layer;
    if (!layer) return inspector.replaceChildren();
    const at = selected;
    const field = (name, attributes, write) =>
      element("label", { class: attributes.maxlength && "wide" }, name, element("input", { "aria-label": `${name} of the concept`, ...attributes, onchange: ({ target }) => {
        const value = attributes.type ? target.valueAsNumber : target.value.trim();
        if (attributes.type ? Number.isFinite(value) : value) set(at, write(layers[at], value));
      } }));
    const seconds = (name, key) => field(name, { type: "number", step: NUDGE, min: 0, value: layer[key] }, (now, value) => layerAt(now, key, value - now[key]));
    const [from, to] = reach(layer, edges);
    const wider = isWider(layer, from, to) && [
      element("p", {}, `It counts from ${from.toFixed(1)} to ${to.toFixed(1)} s: a sentence is made as a whole.`),
      on.canCut(layer) && element("button", { type: "button", onclick: () => cut(at) }, "Cut the sentences to its span"),
    ];
    return inspector.replaceChildren(
      field("Words", { value: layer.text, maxlength: 512, autocomplete: "off" }, (now, text) => ({ ...now, text })),
      field("Weight", { type: "number", step: 0.1, min: -LIMIT, max: LIMIT, value: layer.weight, title: "Below zero means not" }, (now, weight) => ({ ...now, weight: Math.min(Math.max(weight, -LIMIT), LIMIT) || 1 })),
      seconds("Begin", "begin"),
      seconds("End", "end"),
      ...(wider || []).filter(Boolean),
      element("button", { type: "button", onclick: () => remove(at) }, "Delete the concept"),
    );
  }

  function draw() {
    const focused = [...tracks.querySelectorAll("button")].indexOf(document.activeElement);
    tracks.replaceChildren(...layers.map(bar));
    tracks.querySelectorAll("button")[focused]?.focus();
    if (!inspector.contains(document.activeElement)) inspect();
  }

  function select(at) {
    selected = at === selected ? -1 : at;
    if (selected >= 0) on.selected();
    draw();
    inspect();
  }

  /** A concept over the sentence at the time that is seen. */
  function create() {
    const at = Math.max(0, Math.min(edges.findLastIndex((edge) => edge <= on.now() + 1e-9), edges.length - 2));
    const [begin, end] = [edges[at], edges[at + 1]];
    if (end - begin < SHORTEST_LAYER) return;
    on.change([...layers, { text: NEW, begin, end, weight: 1 }]);
    select(layers.length - 1);
    inspector.querySelector("input").select();
  }
  add.addEventListener("click", create);

  return {
    create,
    deselect: () => selected >= 0 && select(selected),
    show(shown, at) {
      [layers, edges] = [shown, at];
      if (selected >= layers.length) selected = -1;
      draw();
    },
  };
}

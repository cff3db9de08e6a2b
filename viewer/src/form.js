// The fields of the page and the part of a project that they show: one segment, or concepts, and how it is sampled.
import { createConcepts } from "./concepts.js";
import { createGraphEditor } from "./graph_editor.js";
import { createMixing } from "./mixing.js";

const START = [{ text: "a person walks forward", weight: 1 }, { text: "a person waves the right hand", weight: 1 }];
const SAMPLING = ["seed", "guidance", "steps"];

/** on: {again(), fail(error), marks(unknown)} */
export function createForm(side, play, on) {
  const at = (name) => side.querySelector(name);
  const form = at(".wish");
  const field = form.elements;
  const composing = () => field.mode.value === "concepts";
  const concepts = createConcepts(at(".concepts .rows"), at(".add-concept"), on.again);
  const mixing = createMixing(at(".mixing"), play, () => field.method.value, on.again);
  const graph = createGraphEditor(side, field.text, play, on);
  let opened = false; // settings that hold something are opened once, and then stay as the reader has them

  function switchMode() {
    at(".sentence").hidden = composing();
    at(".words").hidden = composing() || !play.phrases.length;
    at(".concepts").hidden = !composing();
    graph.visible(!composing());
  }

  field.method.addEventListener("change", () => {
    mixing.look();
    on.again();
  });
  for (const radio of field.mode) radio.addEventListener("change", switchMode);
  field.text.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" || event.shiftKey) return;
    event.preventDefault();
    form.requestSubmit();
  });
  field.guidance.placeholder = Object.values(play.guidance).join(", ");
  field.steps.placeholder = Object.values(play.steps).join(", ");
  field.seconds.title = `${play.seconds[0]} to ${play.seconds[1]}`;
  concepts.set(START);
  mixing.set({});
  switchMode();

  return {
    element: form,
    field,
    graph,
    /** A project with what the fields say in it. */
    read(project, selected) {
      const seconds = field.seconds.value.trim();
      const sampling = Object.fromEntries(SAMPLING.map((name) => [name, field[name].value.trim()]).filter(([, value]) => value));
      if (!field.foot_fix.checked) sampling.foot_fix = false;
      // parts of a sequence have a length each
      const timed = seconds ? { seconds } : (project.segments.length > 1 || project.layers.length > 0) && { seconds: project.segments[selected].seconds };
      if (composing()) {
        return { ...project, sampling, concepts: { concepts: concepts.get(), method: field.method.value, ...mixing.get(), ...timed } };
      }
      const { offset } = project.segments[selected];
      const segment = { ...graph.wish(), ...timed, ...(offset !== undefined && { offset }) };
      return { ...project, sampling, concepts: null, segments: project.segments.with(selected, segment) };
    },
    /** Show a segment of a project; `known` is its graph, where somebody has parsed it. */
    fill(project, selected, known = null) {
      const segment = project.segments[selected];
      field.mode.value = project.concepts ? "concepts" : "sentence";
      if (project.concepts) {
        concepts.set(project.concepts.concepts);
        field.method.value = project.concepts.method ?? "auto";
        mixing.set(project.concepts);
      }
      if (segment.text || !project.concepts) field.text.value = segment.text;
      graph.load(segment, known);
      field.seconds.value = (project.concepts ?? segment).seconds ?? "";
      for (const name of SAMPLING) field[name].value = project.sampling[name] ?? "";
      field.foot_fix.checked = project.sampling.foot_fix ?? true;
      const is = [...SAMPLING, "foot_fix"].some((name) => name in project.sampling);
      if (is && !opened) at(".sampling").open = opened = true;
      switchMode();
    },
  };
}

// kinegraph play: the form, the run, and what came of it.
import { loadActor } from "./actor.js";
import * as api from "./api.js";
import { createConcepts } from "./concepts.js";
import { createGraphEditor } from "./graph_editor.js";
import { linked } from "./link.js";
import { createResult } from "./result.js";

const START = [{ text: "a person walks forward", weight: 1 }, { text: "a person waves the right hand", weight: 1 }];
const KEPT = 3; // clips beside the newest
const LEVELS = { motion: "whole motion", action: "actions", specific: "details" };

export function openPlayground(side, play, stage, transport) {
  side.append(document.getElementById("playground").content);
  const at = (name) => side.querySelector(name);
  const form = at(".wish");
  const field = form.elements;
  const result = createResult(at(".result"), play, fail);
  const concepts = createConcepts(at(".concepts .rows"), at(".add-concept"), () => again());
  const graph = createGraphEditor(side, field.text, play, { again: () => again(), fail });
  let kept = [];
  let shown = null; // the newest clip's actor
  let run = null; // AbortController of the clip in the making
  let last = null; // the wish of the newest clip, its seed included

  const bar = document.querySelector(".bar");
  const status = document.querySelector(".status");

  function say(text, part = null) {
    status.textContent = text;
    bar.hidden = part === null;
    bar.firstElementChild.style.width = `${100 * (part ?? 0)}%`;
  }

  function fail(error) {
    at(".error").hidden = !error;
    at(".error").textContent = error?.message ?? "";
  }

  /** What the form asks for; only what differs from the bundle's own. */
  function wish() {
    const asked = field.mode.value === "concepts" ? { concepts: concepts.get(), method: field.method.value } : graph.wish();
    for (const name of ["seconds", "seed", "guidance", "steps"]) {
      const value = field[name].value.trim();
      if (value) asked[name] = value;
    }
    if (!field.foot_fix.checked) asked.foot_fix = false;
    return asked;
  }

  function fill(asked) {
    field.mode.value = asked.concepts ? "concepts" : "sentence";
    if (asked.concepts) {
      concepts.set(asked.concepts);
      field.method.value = asked.method ?? "fused";
    }
    if (asked.text) field.text.value = asked.text;
    if (asked.graph) graph.set(asked.graph);
    for (const name of ["seconds", "seed", "guidance", "steps"]) field[name].value = asked[name] ?? "";
    field.foot_fix.checked = asked.foot_fix ?? true;
    at(".settings").open = ["seconds", "seed", "guidance", "steps", "foot_fix"].some((name) => name in asked);
    switchMode();
  }

  function switchMode() {
    const composing = field.mode.value === "concepts";
    at(".sentence").hidden = composing;
    at(".concepts").hidden = !composing;
    graph.visible(!composing);
  }

  async function show(clip, first) {
    const actor = await loadActor(clip);
    stage.show([...kept, actor]);
    shown = actor;
    if (first) transport.restart();
    else transport.refresh();
  }

  function busy(is) {
    at(".cancel").hidden = !is;
    at(".keep").hidden = is || !shown || kept.includes(shown) || kept.length >= KEPT;
    at(".alone").hidden = is || !kept.length;
    form.setAttribute("aria-busy", is);
  }

  /** Make a clip; a run that is under way gives way. */
  async function generate(asked) {
    run?.abort();
    const own = (run = new AbortController());
    const pressed = performance.now();
    fail(null);
    busy(true);
    say("Asking", 0);
    let [drawn, complete] = [false, false];
    try {
      for await (const event of api.clip(asked, own.signal)) {
        if (own.signal.aborted) return;
        if (event.event === "queued") say(event.ahead ? `Waiting for ${event.ahead} before this` : "Starting", 0);
        if (event.event === "graph") graph.parsed(event.graph, asked);
        if (event.event === "step") say(`Finding the ${LEVELS[event.level]}, step ${event.step} of ${event.steps}`, event.done / event.total);
        if (event.event === "error") throw new Error(event.message);
        if (event.event === "level" || event.event === "clip") {
          await show({ ...event.clip, label: label(event) }, !drawn);
          drawn = true;
        }
        if (event.event === "clip") {
          complete = true;
          last = { ...asked, seed: event.clip.seed };
          // a hidden tab draws nothing, and would wait for ever
          if (!document.hidden) await new Promise(requestAnimationFrame);
          result.show(event, last, performance.now() - pressed);
          document.documentElement.dataset.made = Number(document.documentElement.dataset.made ?? 0) + 1;
        }
      }
      if (!complete) throw new Error("The server ended before the clip was done.");
    } catch (error) {
      if (error.name !== "AbortError") fail(error);
    } finally {
      if (run === own) {
        run = null;
        say("");
        busy(false);
      }
    }
  }

  function label({ event, level, clip }) {
    return event === "level" ? `${clip.text} — so far the ${LEVELS[level]}` : `${clip.text}, seed ${clip.seed}`;
  }

  /** The same clip with what has just been changed. */
  function again() {
    if (last && (run || shown)) generate({ ...wish(), seed: field.seed.value.trim() || last.seed });
  }

  form.addEventListener("submit", (event) => {
    event.preventDefault();
    generate(wish());
  });
  field.text.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" || event.shiftKey) return;
    event.preventDefault();
    form.requestSubmit();
  });
  at(".cancel").addEventListener("click", () => run?.abort());
  document.addEventListener("keydown", (event) => event.key === "Escape" && run?.abort());
  at(".keep").addEventListener("click", () => {
    kept.push(shown);
    busy(false);
  });
  at(".alone").addEventListener("click", () => {
    kept = [];
    stage.show([shown]);
    busy(false);
  });
  at(".keep-seed").addEventListener("click", () => (field.seed.value = last?.seed ?? ""));
  for (const radio of field.mode) radio.addEventListener("change", switchMode);

  field.guidance.placeholder = Object.values(play.guidance).join(", ");
  field.steps.placeholder = Object.values(play.steps).join(", ");
  field.seconds.title = `${play.seconds[0]} to ${play.seconds[1]}`;
  concepts.set(START);
  field.text.value = play.example;
  // A link fills the form and runs nothing: another page may open it, and may not drive this one.
  const asked = linked();
  if (asked) fill(asked);
  switchMode();
  field.text.focus();
}

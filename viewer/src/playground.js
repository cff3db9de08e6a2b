// kinegraph play: the form, the run, and what came of it.
import { loadActor } from "./actor.js";
import * as api from "./api.js";
import { createConcepts } from "./concepts.js";
import { named } from "./describe.js";
import { createGraphEditor } from "./graph_editor.js";
import { linked } from "./link.js";
import { createMixing } from "./mixing.js";
import { createResult } from "./result.js";

const START = [{ text: "a person walks forward", weight: 1 }, { text: "a person waves the right hand", weight: 1 }];
const KEPT = 3; // clips beside the newest
const LEVELS = { motion: "whole motion", action: "actions", specific: "details" };
const SAMPLING = ["seconds", "seed", "guidance", "steps"];

export function openPlayground(side, play, stage, transport) {
  side.append(document.getElementById("playground").content);
  const at = (name) => side.querySelector(name);
  const form = at(".wish");
  const field = form.elements;
  const result = createResult(at(".result"), play, fail);
  const concepts = createConcepts(at(".concepts .rows"), at(".add-concept"), () => again());
  const mixing = createMixing(at(".mixing"), play, () => field.method.value, () => again());
  const graph = createGraphEditor(side, field.text, play, { again: () => again(), fail });
  let kept = [];
  let newest = null; // the newest clip that is done
  let shown = null; // its actor
  let front = null; // what is seen now: that, or a sketch
  let shows = 0; // how often something was to be shown
  let run = null; // AbortController of the clip in the making
  let last = null; // the wish of the newest clip, its seed included

  const bar = document.querySelector(".bar");
  const [status, count] = document.querySelectorAll(".status span");

  /** `detail` changes too often to be read out. */
  function say(text, part = null, detail = "") {
    if (status.textContent !== text) status.textContent = text;
    count.textContent = detail;
    bar.hidden = part === null;
    bar.firstElementChild.style.width = `${100 * (part ?? 0)}%`;
  }

  function fail(error) {
    at(".error").hidden = !error;
    at(".error").textContent = error?.message ?? "";
  }

  /** What the form asks for; only what differs from the bundle's own. */
  function wish() {
    const composing = field.mode.value === "concepts";
    const asked = composing ? { concepts: concepts.get(), method: field.method.value, ...mixing.get() } : graph.wish();
    for (const name of SAMPLING) {
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
      mixing.set(asked);
    } else if (asked.text) field.text.value = asked.text;
    if (asked.graph) graph.set(asked.graph);
    for (const name of SAMPLING) field[name].value = asked[name] ?? "";
    field.foot_fix.checked = asked.foot_fix ?? true;
    at(".sampling").open = [...SAMPLING, "foot_fix"].some((name) => name in asked);
    switchMode();
  }

  function switchMode() {
    const composing = field.mode.value === "concepts";
    at(".sentence").hidden = composing;
    at(".concepts").hidden = !composing;
    graph.visible(!composing);
  }

  /** Show a clip or sketch; one that a later one overtakes while it is unpacked is left out. */
  async function show(clip, restart) {
    const own = ++shows;
    const actor = await loadActor(clip);
    if (own !== shows) {
      actor.dispose();
      return null;
    }
    stage.show([...kept, actor]);
    front = actor;
    if (restart) transport.restart();
    else transport.refresh();
    return actor;
  }

  /** What was seen before a clip that did not come about. */
  async function goBack() {
    shows += 1; // a sketch that is being unpacked comes too late
    if (front === shown) return;
    if (newest && !kept.includes(shown)) shown = (await show(newest, false)) ?? shown;
    else {
      stage.show(kept);
      front = shown;
      transport.refresh();
    }
  }

  function busy(is) {
    const buttons = [".cancel", ".keep", ".alone"].map(at);
    const focused = document.activeElement;
    at(".cancel").hidden = !is;
    at(".keep").hidden = is || !shown || kept.includes(shown) || kept.length >= KEPT;
    at(".alone").hidden = is || !kept.length;
    form.setAttribute("aria-busy", is);
    if (focused.hidden && buttons.includes(focused)) at(".generate").focus(); // the keyboard stays where it was
  }

  /** Make a clip; a run that is under way gives way. One that only `changes` the last plays on from where that is. */
  async function generate(asked, changes = false) {
    run?.abort();
    shows += 1;
    const own = (run = new AbortController());
    const pressed = performance.now();
    const seen = { sketch: null, clip: null }; // milliseconds until each was drawn
    let [begun, complete] = [changes, false];
    const drawn = async (clip, what) => {
      const actor = await show(clip, !begun);
      if (!actor) return null;
      begun = true;
      // a hidden tab draws nothing, and would wait for ever
      if (!document.hidden) await new Promise(requestAnimationFrame);
      if (front === actor) seen[what] ??= performance.now() - pressed; // else it was overtaken before it was drawn
      return actor;
    };
    fail(null);
    busy(true);
    say("Asking", 0);
    try {
      for await (const event of api.clip(asked, own.signal)) {
        if (own.signal.aborted) return;
        if (event.event === "queued") say(event.ahead ? `Waiting for ${event.ahead} before this` : "Starting", 0);
        if (event.event === "graph") graph.parsed(event.graph, asked);
        if (event.event === "step") {
          say(`Finding the ${LEVELS[event.level]}`, event.done / event.total, `, step ${event.step} of ${event.steps}`);
        }
        if (event.event === "error") throw new Error(event.message);
        if (event.event === "level") {
          const sketch = { ...event.clip, label: `Sketch of the ${LEVELS[event.level]}` };
          drawn(sketch, "sketch").catch(fail); // not waited for: what follows may overtake it
        }
        if (event.event === "clip") {
          const clip = { ...event.clip, label: named(event.clip, asked) };
          const actor = await drawn(clip, "clip");
          if (own.signal.aborted) return;
          [newest, shown, complete] = [clip, actor, true];
          last = { ...asked, seed: event.clip.seed };
          result.show(event, last, seen);
          document.documentElement.dataset.made = Number(document.documentElement.dataset.made ?? 0) + 1;
        }
      }
      if (!complete) throw new Error("The server ended before the clip was done.");
    } catch (error) {
      if (error.name !== "AbortError") fail(error);
    } finally {
      if (run === own) {
        run = null;
        if (!complete) await goBack();
        if (!run) {
          say("");
          busy(false);
        } // else another has begun meanwhile
      }
    }
  }

  /** The same clip with what has just been changed. */
  function again() {
    if (last && (run || shown)) generate({ ...wish(), seed: field.seed.value.trim() || last.seed }, true);
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
    transport.refresh();
    busy(false);
  });
  at(".keep-seed").addEventListener("click", () => (field.seed.value = last?.seed ?? ""));
  field.method.addEventListener("change", () => {
    mixing.look();
    again();
  });
  for (const radio of field.mode) radio.addEventListener("change", switchMode);

  field.guidance.placeholder = Object.values(play.guidance).join(", ");
  field.steps.placeholder = Object.values(play.steps).join(", ");
  field.seconds.title = `${play.seconds[0]} to ${play.seconds[1]}`;
  concepts.set(START);
  mixing.set({});
  field.text.value = play.example;
  // A link fills the form and runs nothing: another page may open it, and may not drive this one.
  const asked = linked();
  if (asked) fill(asked);
  switchMode();
  field.text.focus();
}

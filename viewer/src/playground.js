// kinegraph play: what is authored, its history, and what of it is seen.
//
// A project (project.js) is shown in the form (form.js), made by the server (maker.js), and drawn on the stage. Every
// made clip is a step of the history and a take of its words. Clips are kept here for a while: to undo makes nothing.
import { loadActor } from "./actor.js";
import * as api from "./api.js";
import { createCharacters } from "./characters.js";
import { createConstraining } from "./constraining.js";
import { fitted } from "./constraints.js";
import { madeOf, named } from "./describe.js";
import { createDragging } from "./dragging.js";
import { createForm } from "./form.js";
import { createHistory } from "./history.js";
import { createKeep, keptFile } from "./keep.js";
import { createKeys } from "./keys.js";
import { createLayers } from "./layers.js";
import { fittedLayers, MOST_LAYERS } from "./layering.js";
import { linked, linkOf } from "./link.js";
import { createMaker } from "./maker.js";
import { createOutput } from "./output.js";
import { checked, cutAt, edges, inserted, isSequence, kindOf, newProject, projectOf, segmentAt, wishOf } from "./project.js";
import { createProjectFiles } from "./project_file.js";
import { createResult } from "./result.js";
import { createTakes } from "./takes.js";
import { createTimeline } from "./timeline.js";
import { createMarks, createWords } from "./words.js";

const KEPT = 3; // clips beside the newest
const MOST_CLIPS = 40; // kept to be shown again: 100 kB each
const NEXT = "a person stands still";
const NEXT_SECONDS = 2;
const STRIP_TIME = 0.6; // of a clip: when it is drawn for the strip
const PICTURE_WAIT = 600; // milliseconds at most until it is drawn
const BEGIN_WAIT = 2000; // milliseconds at most until somebody moves
const STEP_PAUSE = 150; // milliseconds: who changes or undoes step after step waits for no clip between

const count = (name) => {
  const { dataset } = document.documentElement;
  dataset[name] = Number(dataset[name] ?? 0) + 1;
};

export async function openPlayground(side, play, stage, transport, clock) {
  side.append(document.getElementById("playground").content);
  side.before(document.getElementById("authoring").content);
  const keep = createKeep();
  const [file, opened] = await Promise.all([keptFile.load(), !play.waits && !linked() && !keep.has() && play.opening ? loadActor(play.opening) : null]);
  let early = file ? null : opened; // who is drawn while the page is still being built: that takes the longest
  if (early) stage.show([early]);
  const at = (name) => document.querySelector(name);
  const made = new Map(); // wish with its seed, as JSON -> the server's event
  let project = newProject(play.example);
  let seen = project; // what the clip that is seen was made of: the form may hold other words by then
  let selected = 0; // segment in the form
  let seed = null; // of the clip that is seen
  let kept = []; // actors beside it
  let newest = null; // the clip that is seen
  let shown = null; // its actor
  let front = null; // what is seen now: that, or a sketch
  let time = 0; // of the clip that is seen, seconds
  let shows = 0; // how often something was to be shown
  let asked = 0; // how often a clip or a step was asked for
  let dressing = null; // AbortController of a character for a step
  let choosing = null; // AbortController of a character that was chosen
  let taking = null; // AbortController of takes in the making

  const fail = (error) => {
    at(".error").hidden = !error;
    at(".error").textContent = error?.message ?? "";
  };
  const history = createHistory(() => {
    at(".undo").disabled = !history.canUndo;
    at(".redo").disabled = !history.canRedo;
    keep.save(history);
  });
  const form = createForm(side, play, { again, fail, marks: (unknown) => marks.show(unknown) });
  const { field } = form;
  const marks = createMarks(field.text, at(".behind"));
  const words = createWords(at(".words"), field.text, play.phrases, say);
  const result = createResult(at(".result"), () => linkOf(wishOf(seen, seed), project.output));
  const takes = createTakes(at(".takes"), { pick, more }, drawTake);
  const output = createOutput(at(".export"), play, { shape, output: files, fetch: fetchFile, fail, say: (text) => maker.running || maker.say(text) });
  const characters = createCharacters(at(".character"), at(".dropping"), play.character_bytes, { changed: dress, fail, project: (file) => projectFiles.open(file) });
  const timeline = createTimeline(at(".timeline"), play.seconds, { read: () => read(), select, change, add, seek: transport.seek });
  clock.addEventListener("time", (event) => timeline.at((time = event.detail)));
  const constraining = createConstraining(at(".timeline"), at(".view"), stage, play, {
    project: () => project,
    clip: () => newest,
    body: async () => (shown?.body ? shown : loadActor(newest)),
    time: () => time,
    now: () => timeline.now,
    whole: () => timeline.whole,
    seek: transport.seek,
    selected: () => layers.deselect(),
    change: constrain,
    colour: stage.colour,
    say: (text) => maker.say(text),
  });
  const layers = createLayers(at(".timeline"), {
    selected: constraining.deselect,
    now: () => timeline.now,
    cut: cutTo,
    canCut: (layer) => {
      const known = timeline.timed();
      return cutToSpan(known, layer) !== known;
    },
    change: (changed) => change({ ...timeline.timed(), layers: changed.slice(0, MOST_LAYERS) }, selected),
  });
  const projectFiles = createProjectFiles(at(".tools .menu"), history, { opened: () => go(history.now), fresh, fail });
  const maker = createMaker({ show, isFront: (actor) => front === actor, back, busy, fail, graph: form.graph.parsed });
  const read = () => form.read(project, selected);
  const dragging = createDragging({
    draft: (next) => (characters.current ? null : maker.draft(wishOf(next, sameSeed(next)))),
    make: (next) => make(next, { changes: true, own: sameSeed(next), step: false, isTaken: false }),
  });
  /** Seed of what only changes the clip that is seen. */
  const sameSeed = (next) => next.sampling.seed ?? seed ?? undefined;

  // -- what is seen -------------------------------------------------------------------------------------------------

  /** Show a clip or sketch; one that a later one overtakes while it is unpacked is left out. */
  async function show(clip, restart, character = null) {
    const own = ++shows;
    const actor = earlier(clip, character) ?? (await loadActor(clip, character));
    if (own !== shows) {
      actor.dispose();
      return null;
    }
    stage.show([...kept, actor]);
    front = actor;
    if (clip.level === "draft") count("drafts");
    if (restart) transport.restart();
    else transport.refresh();
    return actor;
  }

  /** The actor that is drawn already, if the first clip is its own. */
  function earlier(clip, character) {
    const actor = !character && early?.clip.glb === clip.glb ? Object.assign(early, { clip }) : null;
    early = null;
    return actor;
  }

  /** What was seen before a clip that did not come about. */
  async function back() {
    shows += 1; // a sketch that is being unpacked comes too late
    if (front === shown) return;
    if (newest && !kept.includes(shown)) shown = (await show(newest, false, await dressed(newest))) ?? shown;
    else {
      stage.show(kept);
      front = shown;
      transport.refresh();
    }
  }

  function busy(is) {
    if (is) shows += 1;
    const buttons = [".cancel", ".keep", ".alone"].map(at);
    const focused = document.activeElement;
    at(".cancel").hidden = !is;
    at(".keep").hidden = is || !shown || kept.includes(shown) || kept.length >= KEPT;
    at(".alone").hidden = is || !kept.length;
    form.element.setAttribute("aria-busy", is);
    if (focused.hidden && buttons.includes(focused)) at(".generate").focus(); // the keyboard stays where it was
  }

  /** The own character with a clip of a project, or null. */
  const dressed = (clip, signal, of = seen) =>
    characters.current ? api.character(wishOf(of, clip.seed), characters.current, {}, signal) : null;

  /** What stands around a clip of a project that is seen now; `took` is how long it was until then. */
  function settle(of, event, actor, { took = null, isTaken = true } = {}) {
    [seen, newest, shown, seed] = [of, event.clip, actor, event.clip.seed];
    const anew = (took && event.made) || null; // sentences that were made now
    result.show(event.clip, event.stages, took, madeOf(anew, of.segments.length));
    at(".export").hidden = false;
    output.show(event.clip, wishOf(of, seed), characters.current?.name ?? null);
    drawTimeline(project, anew);
    constraining.show(event.clip.misses ?? []);
    if (isTaken) takes.add(kindOf(of), seed, event);
    takes.show(kindOf(of), seed);
    takes.lock.checked = "seed" in project.sampling;
    history.amend({ seed });
    count("shown");
  }

  function remember(wish, event) {
    made.set(JSON.stringify(wish), event);
    if (made.size > MOST_CLIPS) made.delete(made.keys().next().value);
  }

  // -- making -------------------------------------------------------------------------------------------------------

  /** Make a clip of a project, as a new step. One that only `changes` what is seen plays on from where that is. */
  async function make(next, { changes = false, own = next.sampling.seed, step = true, isTaken = true, draft = false } = {}) {
    asked += 1;
    project = next;
    selected = Math.min(selected, project.segments.length - 1);
    if (step) history.push({ project });
    const wish = wishOf(project, own);
    const finish = (clip, signal) => dressed(clip, signal, next);
    const done = await maker.make(wish, { changes, sketches: !characters.current, draft: draft && !characters.current, finish });
    if (!done?.actor) return false;
    remember(wishOf(next, done.event.clip.seed), done.event);
    settle(next, done.event, done.actor, { took: done.seen, isTaken });
    if (!maker.running) busy(false);
    count("made");
    return true;
  }

  /** The same clip with what has just been changed; of changes in quick succession, with all of them at once. */
  async function again() {
    if (!newest && !maker.running) return;
    const own = (asked += 1);
    if (maker.running) await new Promise((resolve) => setTimeout(resolve, STEP_PAUSE));
    if (own !== asked) return;
    const next = read();
    make(next, { changes: true, own: sameSeed(next) });
  }

  /** Show a step: from what is kept here, or made anew. */
  async function go(entry, changes = false) {
    if (!entry) return;
    asked += 1;
    maker.giveWay();
    choosing?.abort();
    project = entry.project;
    selected = Math.min(selected, project.segments.length - 1);
    const event = made.get(JSON.stringify(wishOf(project, entry.seed)));
    form.fill(project, selected, event && !project.concepts ? event.clip.graph : null);
    output.fill(project);
    fail(null);
    const own = asked;
    dressing?.abort();
    if (changes && (!event || characters.current)) await new Promise((resolve) => setTimeout(resolve, STEP_PAUSE));
    if (own !== asked) return false;
    if (!event) return make(project, { own: entry.seed ?? project.sampling.seed, changes, step: false });
    const clip = { ...event.clip, label: named(event.clip, wishOf(project, event.clip.seed)) };
    dressing = new AbortController();
    const character = await Promise.resolve(dressed(event.clip, dressing.signal, entry.project)).catch((error) => error);
    if (own !== asked) return false; // another step was asked for meanwhile
    if (character instanceof Error) fail(character);
    const actor = await show(clip, !changes, character instanceof Error ? null : character);
    if (actor) settle(entry.project, event, actor);
    busy(false);
  }

  function say(sentence) {
    field.text.value = sentence;
    field.text.dispatchEvent(new Event("input"));
    form.element.requestSubmit();
  }

  // -- timeline -----------------------------------------------------------------------------------------------------

  const drawTimeline = (of = project, anew = null) => {
    const seconds = newest ? newest.frames / newest.fps : 0;
    timeline.show(of, selected, seconds, anew);
    layers.show(of.layers, of.segments.every(({ seconds }) => seconds) ? edges(of) : [0, seconds]);
  };

  /** Another segment into the form; what stands there is kept, and made when it is asked for. */
  function select(which) {
    project = read();
    selected = which;
    form.fill(project, selected);
    drawTimeline();
  }

  /** A project that was changed on the timeline is made at once, with the same seed. */
  function change(changed, which) {
    const whole = edges(changed).at(-1);
    const next = { ...changed, constraints: fitted(changed.constraints, whole), layers: fittedLayers(changed.layers, whole) };
    selected = which;
    form.fill(next, selected);
    drawTimeline(next);
    make(next, { changes: true, own: sameSeed(next) });
  }

  /** Sentences cut where a concept begins and ends, as far as each stays long enough. */
  const cutToSpan = (known, { begin, end }) => cutAt(cutAt(known, begin, play.seconds[0]), end, play.seconds[0]);

  /** Cut sentences so that a concept counts for its span alone. */
  function cutTo(layer) {
    const next = cutToSpan(timeline.timed(), layer);
    change(next, segmentAt(next, layer.begin).at);
  }

  /** Other constraints: while one is dragged, drafts and the clip where it rests; else the clip, a draft before it. */
  function constrain(constraints, done) {
    const next = { ...read(), constraints };
    if (!done) return dragging.to(next);
    dragging.end();
    project = next;
    constraining.show([]);
    return make(next, { changes: true, own: sameSeed(next), draft: constraints.length > 0 });
  }

  function add() {
    const whole = timeline.timed();
    const next = inserted(whole, selected + 1, { text: NEXT, seconds: NEXT_SECONDS });
    if (next === whole) return;
    change(next, selected + 1);
    field.text.focus();
    field.text.select();
  }

  // -- takes --------------------------------------------------------------------------------------------------------

  /** A take of what is seen; other words that stand in the form are a step to go back to. */
  function pick(own) {
    const typed = read();
    const same = kindOf(typed) === kindOf(seen);
    if (!same) history.push({ project: typed });
    const of = same ? typed : { ...seen, output: project.output };
    const sampling = { ...of.sampling, ...("seed" in of.sampling && { seed: own }) };
    history.push({ project: { ...of, sampling }, seed: own });
    return go(history.now);
  }

  /** More takes of what is seen. */
  async function more(seeds) {
    const [kind, of, own] = [kindOf(seen), seen, (taking = new AbortController())];
    const say = (...words) => maker.running || maker.say(...words); // a clip in the making is told of first
    at(".cancel").hidden = false;
    try {
      for (const [index, next] of seeds.entries()) {
        say(`Take ${index + 1} of ${seeds.length}`, index / seeds.length);
        const event = await maker.quietly(wishOf(of, next), own.signal);
        remember(wishOf(of, next), event);
        takes.add(kind, next, event);
      }
    } catch (error) {
      if (error.name !== "AbortError") fail(error);
    }
    taking = null;
    say("");
    if (!maker.running) busy(false);
  }

  function cancel() {
    maker.cancel();
    taking?.abort();
  }

  /** When nothing else is to be drawn: a picture takes as long as a frame of the clip. */
  const idle = () => new Promise((resolve) => (window.requestIdleCallback ? requestIdleCallback(resolve, { timeout: PICTURE_WAIT }) : setTimeout(resolve, PICTURE_WAIT)));

  async function drawTake({ clip }) {
    // the first picture must not delay the first movement
    if (transport.playing) await Promise.race([stage.beginning, new Promise((resolve) => setTimeout(resolve, BEGIN_WAIT))]);
    await idle();
    const seen = front === shown && shown?.clip.glb === clip.glb;
    const actor = seen ? shown : await loadActor(clip);
    const url = stage.picture(actor, STRIP_TIME * actor.duration);
    if (!seen) actor.dispose();
    return url;
  }

  // -- output -------------------------------------------------------------------------------------------------------

  function shape(wanted) {
    project = { ...project, shape: wanted };
    again();
  }

  function files(wanted) {
    project = { ...project, output: wanted };
    history.push({ project, seed });
  }

  async function fetchFile(suffix) {
    const wish = wishOf(seen, seed);
    const { fps, root, names } = project.output;
    if (characters.current && suffix === ".glb") return new Blob([await api.character(wish, characters.current, { fps, root })]);
    return api.file(wish, suffix, { fps, ...(play.named.includes(suffix) && { root, names }) });
  }

  /** Another character, or none: what is seen is seen on it. False if it cannot be used. */
  async function dress() {
    if (!newest) return true;
    choosing?.abort(); // another was chosen, or none
    const own = (choosing = new AbortController());
    maker.say("Putting it on", 0.5);
    try {
      const character = await dressed(newest, own.signal);
      if (own.signal.aborted) return true;
      const actor = await show({ ...newest, label: named(newest, wishOf(seen, seed)) }, false, character);
      if (actor) {
        shown = actor;
        output.show(newest, wishOf(seen, seed), characters.current?.name ?? null);
        count("shown");
      }
      fail(null);
      return true;
    } catch (error) {
      if (own.signal.aborted) return true;
      fail(error);
      return false;
    } finally {
      if (choosing === own) {
        choosing = null;
        maker.say("");
      }
    }
  }

  // -- history ------------------------------------------------------------------------------------------------------

  const undo = () => go(history.undo(), true);
  const redo = () => go(history.redo(), true);

  function fresh() {
    project = newProject(play.example);
    selected = 0;
    history.push({ project, ...(play.opening && { seed: play.opening.seed }) });
    go(history.now);
    field.text.select();
  }

  // -- begin --------------------------------------------------------------------------------------------------------

  form.element.addEventListener("submit", (event) => {
    event.preventDefault();
    const next = read();
    const changes = isSequence(next) && seed !== null && !made.has(JSON.stringify(wishOf(next, seed)));
    make(next, changes ? { changes, own: sameSeed(next) } : {});
  });
  at(".cancel").addEventListener("click", cancel);
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
  const lock = (is) => {
    field.seed.value = is ? (seed ?? "") : "";
    takes.lock.checked = is;
  };
  at(".keep-seed").addEventListener("click", () => lock(true));
  takes.lock.addEventListener("change", () => lock(takes.lock.checked));
  at(".undo").addEventListener("click", undo);
  at(".redo").addEventListener("click", redo);
  const keys = createKeys(
    at("dialog.keys"),
    [
      { key: "Enter", ctrl: true, inFields: true, say: "Generate", act: () => form.element.requestSubmit() },
      { key: "Escape", inFields: true, say: "Cancel", act: () => constraining.cancel() || (maker.running || taking ? cancel() : false) },
      { key: "/", say: "To the sentence", act: () => field.text.focus() },
      { key: "f", say: "Search known words", act: words.search },
      { key: "z", ctrl: true, shift: false, say: "Undo", act: undo },
      { key: "z", ctrl: true, shift: true, say: "Redo", act: redo },
      { key: "y", ctrl: true, act: redo },
      { key: "n", say: "Another sentence behind this one", act: add },
      { key: "x", say: "Cut the sentence at this time", act: timeline.split },
      ...(play.constrained
        ? [{ key: "p", say: "Draw a path on the floor", act: constraining.path }, { key: "w", say: "A waypoint at this time", act: constraining.waypoint }, { key: "c", say: "A concept over this sentence", act: layers.create }]
        : []),
      { key: "t", say: "More takes", act: takes.more },
      { key: "[", say: "Take before", act: () => takes.step(-1) },
      { key: "]", say: "Next take", act: () => takes.step(1) },
      { key: "l", say: "Keep the seed, or not", act: () => lock(!takes.lock.checked) },
      { key: "s", ctrl: true, inFields: true, say: "Save the project as a file", act: () => projectFiles.save() },
      { key: "?", say: "These keys", act: () => keys.show() },
    ],
    [["Space", "Play or pause"], [", .", "One frame back or on"], ["0", "Camera back to its place"], ["Arrows", "Turn the camera, on the stage"], ["+ -", "Nearer, further, on the stage"],
      ["\u2190 \u2192", "Select a sentence, on the timeline"], ["Shift + \u2190 \u2192", "Make it shorter, longer"],
      ["Alt + \u2190 \u2192", "Move it"], ["Delete", "Remove it"]],
  );
  at(".help").addEventListener("click", keys.show);

  addEventListener("hashchange", () => {
    const found = linked();
    const link = found && stepOf(found);
    if (!link) return;
    history.push(link);
    wait(link, "Press Generate to make what the link says"); // another page may have opened it in this tab
  });
  characters.restore(file);
  begin();

  /** A step in the form that is made when it is asked for. */
  function wait(step, said) {
    project = step.project;
    selected = 0;
    form.fill(project, 0);
    output.fill(project);
    maker.say(said);
  }

  /** What a link says, as a step; null for a link that says nothing of ours. */
  function stepOf({ wish, output: shape }) {
    try {
      return { project: checked(projectOf(wish, shape)), ...(wish.seed && { seed: wish.seed }) };
    } catch (error) {
      fail(error);
      return null;
    }
  }

  /** What the link says, or what was kept, or the clip that the page came with. A link is a step after what was kept. */
  function begin() {
    const reloaded = performance.getEntriesByType("navigation")[0]?.type === "reload";
    if (play.opening) remember(wishOf(project, play.opening.seed), { clip: play.opening });
    const had = keep.load(history);
    const found = had && reloaded ? null : linked(); // what a link said is kept when the page is loaded again
    const link = found && stepOf(found);
    if (link) history.push(link);
    else if (!had) history.push({ project, ...(play.opening && { seed: play.opening.seed }) });
    const { now } = history;
    // Another page may open a link, and may not drive this one: then it is made when it is asked for.
    if (play.waits || !now.seed && !link) wait(now, link ? "Press Generate to make what the link says" : "Press Generate to make it");
    else go(now);
    if (matchMedia("(pointer: fine)").matches) field.text.focus();
  }
}

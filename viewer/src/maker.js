// Making a clip: the request, its events, sketches on the way, cancelling; one at a time.
import * as api from "./api.js";
import { named } from "./describe.js";

const LEVELS = { motion: "whole motion", action: "actions", specific: "details", constraints: "way there" };
const DRAFT = "Draft, until the motion is made";

/**
 * @param on {show(clip, restart, extra) -> actor or null, isFront(actor), back(), busy(is), fail(error),
 *   graph(graph, wish)}
 */
export function createMaker(on) {
  const bar = document.querySelector(".bar");
  const [status, count] = document.querySelectorAll(".status span");
  let run = null; // AbortController of the clip in the making

  /** `detail` changes too often to be read out. */
  function say(text, part = null, detail = "") {
    if (status.textContent !== text) status.textContent = text;
    count.textContent = detail;
    bar.hidden = part === null;
    bar.firstElementChild.style.width = `${100 * (part ?? 0)}%`;
  }

  /** Show what is made as soon as it is there; milliseconds until each was drawn are noted in `seen`. */
  function createDrawing(changes, seen) {
    const pressed = performance.now();
    let begun = changes;
    return async (clip, what, extra) => {
      const actor = await on.show(clip, !begun, extra);
      if (!actor) return null;
      begun = true;
      // a hidden tab draws nothing, and would wait for ever
      if (!document.hidden) await new Promise(requestAnimationFrame);
      if (on.isFront(actor)) seen[what] ??= performance.now() - pressed; // else it was overtaken before it was drawn
      return actor;
    };
  }

  async function follow(wish, own, drawn, { sketches, finish }) {
    for await (const event of api.clip(wish, own.signal)) {
      if (own.signal.aborted) return null;
      if (event.event === "queued") say(event.ahead ? `Waiting for ${event.ahead} before this` : "Starting", 0);
      if (event.event === "graph") on.graph(event.graph, wish);
      if (event.event === "step") {
        say(`Finding the ${LEVELS[event.level]}`, event.done / event.total, `, step ${event.step} of ${event.steps}`);
      }
      if (event.event === "error") throw new Error(event.message);
      if (event.event === "level" && sketches) {
        const sketch = { ...event.clip, label: `Sketch of the ${LEVELS[event.level]}` };
        drawn(sketch, "sketch").catch(on.fail); // not waited for: what follows may overtake it
      }
      if (event.event === "clip") {
        const extra = await finish(event.clip, own.signal);
        const actor = await drawn({ ...event.clip, label: named(event.clip, wish) }, "clip", extra);
        return own.signal.aborted ? null : { event, actor };
      }
    }
    throw new Error("The server ended before the clip was done.");
  }

  /** Show a draft of a wish, if the server has one. What is wrong with the wish, the clip itself will say. */
  async function showDraft(wish, own, drawn) {
    try {
      for await (const event of api.clip({ ...wish, draft: true }, own.signal)) {
        if (event.event === "draft" && !own.signal.aborted) await drawn({ ...event.clip, label: DRAFT }, "draft");
      }
    } catch (error) {
      if (error.name === "AbortError") throw error;
    }
  }

  return {
    get running() {
      return run !== null;
    },
    cancel: () => run?.abort(),
    /** Give way to something else that is shown: what was seen before is not shown again. */
    giveWay() {
      run?.abort();
      run = null;
      say("");
    },
    say,
    /**
     * Make the clip of a wish; one that is under way gives way. One that only `changes` the last plays on from where
     * that is. `draft` shows one first. `finish(clip, signal)` gets what else is to be had before it is shown. Resolves to {event, actor, seen}, or to null where it was cancelled or failed, which is told.
     */
    async make(wish, { changes = false, sketches = true, draft = false, finish = async () => null } = {}) {
      run?.abort();
      const own = (run = new AbortController());
      const seen = { draft: null, sketch: null, clip: null };
      let made = null;
      on.fail(null);
      on.busy(true);
      say("Asking", 0);
      try {
        const drawn = createDrawing(changes, seen);
        if (draft) await showDraft(wish, own, drawn);
        made = await follow(wish, own, drawn, { sketches: sketches && seen.draft === null, finish });
      } catch (error) {
        if (error.name !== "AbortError") on.fail(error);
      } finally {
        if (run === own) {
          run = null;
          if (!made) await on.back();
          if (!run) {
            say("");
            on.busy(false);
          } // else another has begun meanwhile
        }
      }
      return made && { ...made, seen };
    },
    /** Show a draft of a wish alone; a clip that is under way gives way. */
    async draft(wish) {
      run?.abort();
      const own = (run = new AbortController());
      try {
        await showDraft(wish, own, createDrawing(true, { draft: null }));
      } catch {
        // another has begun meanwhile
      } finally {
        if (run === own) run = null;
      }
    },
    /** The last event of a clip that is made without being shown. */
    async quietly(wish, signal) {
      for await (const event of api.clip(wish, signal)) {
        if (event.event === "error") throw new Error(event.message);
        if (event.event === "clip") return event;
      }
      throw new Error("The server ended before the clip was done.");
    },
  };
}

// Making a clip: the request, its events, sketches on the way, cancelling; one at a time.
import * as api from "./api.js";
import { named } from "./describe.js";

const LEVELS = { motion: "whole motion", action: "actions", specific: "details", constraints: "way there" };

/**
 * @param on {show(clip, restart, extra) -> actor or null, isFront(actor), back(), busy(is), fail(error),
 *   graph(graph, wish)}
 */
export function createMaker(on) {
  const bar = document.querySelector(".bar");
  const [status, count] = document.querySelectorAll(".status span");
  let run = null; // AbortController of the clip in the making
  let sketched = false; // whether a sketch of it has been seen

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
      sketched = true;
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

  return {
    get running() {
      return run !== null;
    },
    get sketched() {
      return sketched;
    },
    cancel: () => run?.abort(),
    say,
    /**
     * Make the clip of a wish; one that is under way gives way. One that only `changes` the last plays on from where
     * that is. `finish(clip, signal)` gets what else is to be had before it is shown. Resolves to {event, actor, seen}, or to null where it was cancelled or failed, which is told.
     */
    async make(wish, { changes = false, sketches = true, finish = async () => null } = {}) {
      run?.abort();
      const own = (run = new AbortController());
      const seen = { sketch: null, clip: null };
      let made = null;
      sketched = false;
      on.fail(null);
      on.busy(true);
      say("Asking", 0);
      try {
        made = await follow(wish, own, createDrawing(changes, seen), { sketches, finish });
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
    /** The last event of a clip that is made without being shown. */
    async quietly(wish) {
      for await (const event of api.clip(wish)) {
        if (event.event === "error") throw new Error(event.message);
        if (event.event === "clip") return event;
      }
      throw new Error("The server ended before the clip was done.");
    },
  };
}

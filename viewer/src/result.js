// What of a clip stands below the form: facts, what it could not honour, latency of each stage, the link.
import { facts } from "./describe.js";
import { element } from "./elements.js";
import { copied } from "./output.js";
import { tell } from "./told.js";

/** url() is the link of what is seen. */
export function createResult(box, url) {
  const link = box.querySelector(".link");
  link.addEventListener("click", () => {
    history.replaceState(null, "", url());
    copied(link, location.href);
  });

  return {
    /** clip; stages: stage -> milliseconds, and `seen`: milliseconds from button to picture; null where it was not made now; made: which sentences were. */
    show(clip, stages = null, seen = null, made = "") {
      box.hidden = false;
      box.querySelector(".facts").textContent = [facts(clip), made].filter(Boolean).join("; ");
      tell(box.querySelector(".told"), clip);
      box.querySelector(".times").hidden = !stages;
      const row = (stage, ms, is) =>
        element("div", { class: is && "seen" }, element("dt", {}, stage), element("dd", {}, `${ms.toFixed(0)} ms`));
      box.querySelector(".stages").replaceChildren(
        ...Object.entries(stages ?? {}).map(([stage, ms]) => row(stage, ms, false)),
        ...(seen?.draft == null ? [] : [row("draft seen after", seen.draft, true)]),
        ...(seen?.sketch == null ? [] : [row("sketch seen after", seen.sketch, true)]),
        ...(seen?.clip == null ? [] : [row("clip seen after", seen.clip, true)]),
      );
    },
  };
}

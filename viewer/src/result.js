// What stands below the form: facts, latency of each stage, files, the link.
import * as api from "./api.js";
import { facts, fileName } from "./describe.js";
import { element } from "./elements.js";
import { linkOf } from "./link.js";
import { tell } from "./told.js";

export function createResult(box, play, fail) {
  const [names, link] = [".names", ".link"].map((name) => box.querySelector(name));
  let wish = null;
  let name = "clip";

  async function download(suffix) {
    try {
      const named = play.named.includes(suffix) ? names.value : "smpl";
      const url = URL.createObjectURL(await api.file(wish, suffix, named));
      element("a", { href: url, download: `${name}${suffix}` }).click();
      setTimeout(() => URL.revokeObjectURL(url), 10_000);
      fail(null);
    } catch (error) {
      fail(error);
    }
  }

  box.querySelector(".downloads").append(
    ...play.files.map((suffix) =>
      element("button", { type: "button", "data-suffix": suffix, onclick: () => download(suffix) }, suffix.slice(1).toUpperCase()),
    ),
  );
  link.addEventListener("click", async () => {
    const url = linkOf(wish);
    history.replaceState(null, "", url);
    await navigator.clipboard?.writeText(url).catch(() => {}); // without the right to, it stands in the address bar
    link.textContent = "Copied";
    setTimeout(() => (link.textContent = "Link"), 1500);
  });

  return {
    /** made: the server's event; asked: the wish with the clip's seed; seen: milliseconds from button to picture. */
    show(made, asked, seen) {
      wish = asked;
      name = fileName(made.clip);
      box.hidden = false;
      box.querySelector(".facts").textContent = facts(made.clip);
      tell(box.querySelector(".told"), made.clip);
      const row = (stage, ms, seen) =>
        element("div", { class: seen && "seen" }, element("dt", {}, stage), element("dd", {}, `${ms.toFixed(0)} ms`));
      box.querySelector(".stages").replaceChildren(
        ...Object.entries(made.stages).map(([stage, ms]) => row(stage, ms, false)),
        ...(seen.sketch === null ? [] : [row("sketch seen after", seen.sketch, true)]),
        row("clip seen after", seen.clip, true),
      );
    },
  };
}

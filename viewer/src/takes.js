// The strip of takes: clips of the same words from other seeds, beside one another; pick one, or ask for more.
import { element } from "./elements.js";

const MOST = 40; // takes of all words together
const MORE = 3;
const SHOWN = 6; // digits of a seed: its last ones tell takes apart

/**
 * @param on {pick(seed), more(seeds)}; more resolves when they are made
 * @param picture (event) resolves to the address of a small picture of a clip
 */
export function createTakes(box, on, picture) {
  const list = box.querySelector(".strip");
  const [more, lock] = [".more", ".lock"].map((name) => box.parentElement.querySelector(name));
  let takes = []; // {kind, seed, item}, the newest last
  let kind = "";
  let current = "";

  function draw() {
    const shown = takes.filter((take) => take.kind === kind);
    list.replaceChildren(...shown.map(({ item }) => item));
    for (const { item, seed } of shown) {
      const is = seed === current;
      item.firstChild.setAttribute("aria-pressed", is);
      if (is) item.scrollIntoView?.({ block: "nearest", inline: "nearest" });
    }
    box.hidden = shown.length < 2;
  }

  function step(by) {
    const shown = takes.filter((take) => take.kind === kind);
    const at = shown.findIndex(({ seed }) => seed === current) + by;
    if (shown[at]) on.pick(shown[at].seed);
  }

  more.addEventListener("click", async () => {
    const taken = new Set(takes.filter((take) => take.kind === kind).map(({ seed }) => seed));
    const seeds = [];
    for (let next = BigInt(current || 0) + 1n; seeds.length < MORE; next++) if (!taken.has(String(next))) seeds.push(String(next));
    more.disabled = true;
    await on.more(seeds);
    more.disabled = false;
  });

  return {
    /** A clip that was made; it is not shown before it is picked. */
    add(ofKind, seed, event) {
      if (takes.some((take) => take.kind === ofKind && take.seed === seed)) return;
      const image = element("img", { width: 144, height: 108, alt: "" });
      picture(event).then((url) => (image.src = url), () => {}); // without a picture its seed names it
      const label = element("span", { title: `seed ${seed}` }, seed.length > SHOWN ? `…${seed.slice(-SHOWN)}` : `seed ${seed}`);
      const button = element("button", { type: "button", class: "take", "aria-label": `Take with seed ${seed}`, onclick: () => on.pick(seed) }, image, label);
      takes = [...takes, { kind: ofKind, seed, item: element("li", {}, button) }].slice(-MOST);
      if (ofKind === kind) draw();
    },
    show(ofKind, seed) {
      [kind, current] = [ofKind, seed];
      draw();
    },
    step,
    more: () => more.click(),
    get locked() {
      return lock.checked;
    },
    lock,
  };
}

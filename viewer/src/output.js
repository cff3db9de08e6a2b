// How clips leave the page: shape, files, the own character, and the program that makes what is seen.
import { command, python } from "./code.js";
import { fileName } from "./describe.js";
import { element } from "./elements.js";

const CODE = { Python: python, "Command line": command };
export const COPIED = 1500; // milliseconds that a button says so

/**
 * @param facts of the bundle: {files, named}
 * @param on {shape(shape), output(output), fetch(suffix) -> Blob, fail(error), say(text)}
 */
export function createOutput(box, facts, on) {
  const field = (name) => box.querySelector(`[name=${name}]`);
  const [loop, inPlace, fps, root, names] = ["loop", "in_place", "fps", "root", "names"].map(field);
  const [downloads, code, copy, tabs] = [".downloads", ".code pre", ".copy", ".code .tabs"].map((name) => box.querySelector(name));
  let seen = null; // {clip, wish, character} of what is seen
  let language = "Python";

  const shape = () => ({ ...(loop.checked && { loop: true }), ...(inPlace.checked && { in_place: true }) });
  const output = () => ({
    ...(fps.value && { fps: Number(fps.value) }),
    ...(root.checked && { root: true }),
    ...(names.value !== "smpl" && { names: names.value }),
  });

  /** The name of a file says what is in it. */
  function named(suffix) {
    const { fps: rate } = output();
    const shaped = ["loop", "in_place"].filter((name) => seen.wish[name]);
    const parts = [fileName(seen.clip), ...shaped, ...(rate ? [`${rate}fps`] : [])];
    if (seen.character && suffix === ".glb") parts.push(seen.character.replace(/\.\w+$/, "").replace(/[^\p{L}\p{N}]+/gu, "_"));
    return parts.join("_") + suffix;
  }

  async function download(suffix, button) {
    const name = named(suffix); // of what is seen now
    button.disabled = true;
    on.say(`Writing ${name}`);
    try {
      const url = URL.createObjectURL(await on.fetch(suffix));
      element("a", { href: url, download: name }).click();
      setTimeout(() => URL.revokeObjectURL(url), 10_000);
      on.fail(null);
    } catch (error) {
      on.fail(error);
    }
    on.say("");
    button.disabled = false;
    button.focus();
  }

  function write() {
    if (!seen) return;
    code.textContent = CODE[language](seen.wish, output(), named(".glb"), seen.character);
    for (const tab of tabs.children) tab.setAttribute("aria-pressed", tab.textContent === language);
    for (const button of downloads.children) button.title = named(button.dataset.suffix);
  }

  downloads.append(
    ...facts.files.map((suffix) =>
      element("button", { type: "button", "data-suffix": suffix, onclick: (event) => download(suffix, event.currentTarget) }, suffix.slice(1).toUpperCase()),
    ),
  );
  tabs.append(
    ...Object.keys(CODE).map((name) =>
      element("button", { type: "button", onclick: () => { language = name; write(); } }, name),
    ),
  );
  copy.addEventListener("click", () => copied(copy, code.textContent));
  for (const input of [loop, inPlace]) input.addEventListener("change", () => on.shape(shape()));
  for (const input of [fps, root, names]) {
    input.addEventListener("change", () => {
      write();
      on.output(output());
    });
  }

  return {
    output,
    fill(project) {
      loop.checked = Boolean(project.shape.loop);
      inPlace.checked = Boolean(project.shape.in_place);
      root.checked = Boolean(project.output.root);
      names.value = project.output.names ?? "smpl";
      const rate = String(project.output.fps ?? "");
      if (![...fps.options].some(({ value }) => value === rate)) fps.append(element("option", { value: rate }, rate));
      fps.value = rate;
    },
    show(clip, wish, character) {
      seen = { clip, wish, character };
      write();
    },
  };
}

/** Copy text, and say so on the button; without the right to, it is selected for the reader. */
export async function copied(button, text) {
  const said = (button.dataset.said ??= button.textContent); // not what the last press says
  const done = await (navigator.clipboard?.writeText(text) ?? Promise.reject()).then(() => true, () => false);
  button.textContent = done ? "Copied" : "Press Ctrl+C";
  if (!done) {
    const field = element("textarea", { class: "out", "aria-label": "To copy" });
    field.value = text;
    button.after(field);
    field.select();
    document.execCommand?.("copy") && (button.textContent = "Copied");
    field.remove();
    button.focus();
  }
  setTimeout(() => (button.textContent = said), COPIED);
}

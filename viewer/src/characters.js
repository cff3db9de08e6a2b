// The own character: chosen or dropped, kept by the browser, and sent along with what it is to do.
import { keptFile } from "./keep.js";

const SUFFIX = /\.(glb|vrm)$/i;

/**
 * @param most bytes of a file
 * @param on {changed(), fail(error), project(file)}; a dropped file that is no character is a project
 */
export function createCharacters(box, dropping, most, on) {
  const [choose, without, input] = [".choose", ".without", ".character-file"].map((name) => box.querySelector(name));
  let current = null; // {name, data: ArrayBuffer}

  function show() {
    choose.textContent = current ? current.name : "Own…";
    without.hidden = !current;
    without.setAttribute("aria-label", current ? `Without ${current.name}` : "");
  }

  async function use(file) {
    if (!SUFFIX.test(file.name)) return on.fail(new Error(`${file.name} is no .glb or .vrm file.`));
    if (file.size > most) return on.fail(new Error(`${file.name} is larger than ${most >> 20} MiB; make its textures smaller.`));
    const data = await file.arrayBuffer();
    const before = current;
    const own = (current = { name: file.name, data });
    show();
    const fits = await on.changed();
    if (current !== own) return; // another was chosen meanwhile
    if (fits) return keptFile.save(own);
    current = before; // it could not be used
    show();
  }

  choose.addEventListener("click", () => input.click());
  input.addEventListener("change", () => {
    if (input.files[0]) use(input.files[0]);
    input.value = "";
  });
  without.addEventListener("click", () => {
    current = null;
    keptFile.save(null);
    show();
    choose.focus();
    on.changed();
  });
  for (const kind of ["dragenter", "dragover", "dragleave", "drop"]) {
    document.addEventListener(kind, (event) => {
      if (!event.dataTransfer?.types.includes("Files")) return;
      event.preventDefault();
      dropping.hidden = kind === "drop" || (kind === "dragleave" && event.relatedTarget !== null);
      const file = kind === "drop" && event.dataTransfer.files[0];
      if (file && /\.json$/i.test(file.name)) on.project(file);
      else if (file) use(file);
    });
  }

  return {
    get current() {
      return current;
    },
    /** The character of the last visit, as `keptFile` has it; null is none. */
    restore(file) {
      current = file;
      show();
    },
  };
}

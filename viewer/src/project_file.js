// A project as one file: all steps of its history. Nothing of it is on the server.
import { fileName } from "./describe.js";
import { element } from "./elements.js";

const MOST = 50_000_000; // bytes of a file that is read: a hundred steps of many poses have a tenth

/** on: {opened(), fresh(), fail(error)} */
export function createProjectFiles(menu, history, on) {
  const input = menu.querySelector(".open-file");
  const close = () => (menu.open = false);

  function save() {
    const text = JSON.stringify({ kinegraph: 1, ...history.toJSON() });
    const url = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    const { project, seed = "" } = history.now;
    const words = project.concepts ? project.concepts.concepts[0]?.text : project.segments[0].text;
    element("a", { href: url, download: `${fileName({ text: words ?? "project", seed })}.kinegraph.json` }).click();
    setTimeout(() => URL.revokeObjectURL(url), 10_000);
    close();
  }

  async function open(file) {
    close();
    try {
      if (file.size > MOST) throw new Error(`${file.name} is larger than a project.`);
      const value = await file.text().then(JSON.parse).catch(() => {
        throw new Error(`${file.name} is no project of kinegraph: it is no JSON.`);
      });
      history.load(value);
      on.fail(null);
    } catch (error) {
      return on.fail(error);
    }
    return on.opened();
  }

  menu.querySelector(".new").addEventListener("click", () => {
    close();
    on.fresh();
  });
  menu.querySelector(".save").addEventListener("click", save);
  menu.querySelector(".open").addEventListener("click", () => input.click());
  input.addEventListener("change", () => {
    if (input.files[0]) open(input.files[0]);
    input.value = "";
  });
  menu.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    close();
    menu.querySelector("summary").focus();
  });
  document.addEventListener("click", (event) => !menu.contains(event.target) && close());
  return { save, open };
}

// Keys that work anywhere but in a field, and the sheet that shows them all.
import { element } from "./elements.js";

const FIELDS = "textarea, select, input:not([type=range]):not([type=radio]):not([type=checkbox])";

/** keys: [{key, say, act, ctrl?, shift?, inFields?}]; shown: [[what to press, what it does]] besides, of other parts. */
export function createKeys(dialog, keys, shown) {
  const list = dialog.querySelector("dl");
  const named = ({ key, ctrl, shift }) => [ctrl && "Ctrl", shift && "Shift", { " ": "Space" }[key] ?? (key.length === 1 ? key.toUpperCase() : key)].filter(Boolean).join(" + ");
  for (const [press, say] of [...keys.filter(({ say }) => say).map((key) => [named(key), key.say]), ...shown]) {
    list.append(element("div", {}, element("dt", {}, element("kbd", {}, press)), element("dd", {}, say)));
  }
  dialog.querySelector("button").addEventListener("click", () => dialog.close());
  document.addEventListener("keydown", (event) => {
    if (event.altKey || document.querySelector("dialog[open]")) return;
    const ctrl = event.ctrlKey || event.metaKey;
    const found = keys.find(
      (one) =>
        one.key.toLowerCase() === event.key.toLowerCase() &&
        Boolean(one.ctrl) === ctrl &&
        (one.shift === undefined || one.shift === event.shiftKey) &&
        (one.inFields || !event.target.closest(FIELDS)),
    );
    if (!found || found.act(event) === false) return;
    event.preventDefault();
  });
  return { show: () => dialog.showModal() };
}

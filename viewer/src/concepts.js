// The list of concepts: a sentence and a weight each.
import { element } from "./elements.js";

export const MOST = 8;
const LIMIT = 2;

export function createConcepts(list, add, onchange) {
  function row({ text = "", weight = 1 } = {}) {
    const words = element("input", { "aria-label": "Concept", maxlength: 512, value: text, placeholder: "a person waves the right hand" });
    const out = element("output", {});
    const slider = element("input", { type: "range", min: -LIMIT, max: LIMIT, step: 0.05, value: weight, "aria-label": "Weight" });
    const say = () => {
      const value = slider.valueAsNumber;
      out.textContent = value < 0 ? `not ×${-value}` : value ? `×${value}` : "left out";
      out.classList.toggle("not", value < 0);
    };
    slider.addEventListener("input", say);
    slider.addEventListener("change", onchange);
    const item = element("li", {}, words, slider, out);
    const remove = () => {
      const near = item.nextElementSibling ?? item.previousElementSibling;
      item.remove();
      add.disabled = false;
      (near?.querySelector("input") ?? add).focus();
      if (words.value.trim()) onchange();
    };
    item.append(element("button", { type: "button", class: "quiet", title: "Delete", "aria-label": "Delete this concept", onclick: remove }, "✕"));
    say();
    list.append(item);
    add.disabled = list.children.length >= MOST;
    return words;
  }
  add.addEventListener("click", () => row().focus());

  return {
    /** Those that say something and count. */
    get() {
      return [...list.children]
        .map((item) => ({ text: item.querySelector("input").value.trim(), weight: item.querySelector("[type=range]").valueAsNumber }))
        .filter(({ text, weight }) => text && weight);
    },
    set(concepts) {
      list.replaceChildren();
      concepts.forEach(row);
    },
  };
}

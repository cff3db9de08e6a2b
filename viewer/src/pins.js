// The tracks of the timeline: a pin for each constraint, to select, drag in time and delete; its numbers; what adds one.
import { fitted, freed, isTimed, nameOf, pointsOf, shifted, span, textOf, translated } from "./constraints.js";
import { element } from "./elements.js";

const NUDGE = 0.1; // seconds and metres per key
const GOOD = 0.05; // metres: what is missed by more is told
const MOVES = { ArrowUp: [0, 0, NUDGE], ArrowDown: [0, 0, -NUDGE], ArrowLeft: [NUDGE, 0, 0], ArrowRight: [-NUDGE, 0, 0], PageUp: [0, NUDGE, 0], PageDown: [0, -NUDGE, 0] };

/**
 * @param box the timeline, with `.tracks` and `.inspector`
 * @param on {select(at), change(constraints)}: all constraints as they are to be
 */
export function createPins(box, on) {
  const [tracks, inspector] = [".tracks", ".pin-numbers"].map((name) => box.querySelector(name));
  let constraints = [];
  let misses = [];
  let whole = 1;
  let selected = -1;

  const set = (at, constraint) => on.change(fitted(constraints.with(at, constraint), whole));

  function remove(at) {
    selected = -1;
    on.change(constraints.toSpliced(at, 1));
    (tracks.querySelector("button") ?? box.querySelector(".add-path")).focus();
  }

  function pin(constraint, at) {
    const [begin, end] = span(constraint, whole);
    const miss = misses[at];
    const missed = miss ? `${(100 * miss.metres).toFixed(miss.metres < 0.1 ? 1 : 0)} cm` : "";
    const when = begin === end ? `at ${begin.toFixed(1)} s` : `from ${begin.toFixed(1)} to ${end.toFixed(1)} s`;
    const button = element(
      "button",
      {
        type: "button", class: `pin ${constraint.type}${miss?.metres > GOOD ? " missed" : ""}`, "aria-pressed": String(at === selected),
        "aria-label": `${nameOf(constraint)} ${when}${missed && `, missed by ${missed}`}`,
        title: missed && `${nameOf(constraint)}: missed by ${missed} on average, ${(100 * miss.worst).toFixed(0)} cm at worst`,
      },
      element("span", {}, nameOf(constraint)),
      element("small", {}, missed),
    );
    button.style.left = `min(${(100 * begin) / whole}%, 100% - 84px)`;
    if (end > begin) button.style.width = `${(100 * (end - begin)) / whole}%`;
    button.addEventListener("click", () => on.select(at));
    button.addEventListener("keydown", (event) => pressed(event, at));
    if (isTimed(constraint)) button.addEventListener("pointerdown", (event) => drag(event, button, at));
    return element("div", { class: "track" }, button);
  }

  function drag(event, button, at) {
    if (event.button) return;
    const scale = whole / tracks.clientWidth;
    const from = event.clientX;
    let by = 0;
    button.setPointerCapture(event.pointerId);
    const onmove = (now) => {
      by = (now.clientX - from) * scale;
      button.style.transform = `translateX(${now.clientX - from}px)`;
    };
    const onend = (now) => {
      button.removeEventListener("pointermove", onmove);
      for (const kind of ["pointerup", "pointercancel"]) button.removeEventListener(kind, onend);
      button.style.transform = "";
      if (now.type === "pointerup" && Math.abs(by) > 0.04) set(at, shifted(constraints[at], by, whole));
    };
    button.addEventListener("pointermove", onmove);
    for (const kind of ["pointerup", "pointercancel"]) button.addEventListener(kind, onend);
  }

  function pressed(event, at) {
    const move = MOVES[event.key];
    if (event.key === "Delete" || event.key === "Backspace") remove(at);
    else if (move && event.shiftKey && move[0]) set(at, shifted(constraints[at], -Math.sign(move[0]) * NUDGE, whole));
    else if (move && !event.shiftKey) set(at, translated(constraints[at], move));
    else return;
    event.preventDefault();
  }

  /** The numbers of the selected one: all that is dragged can be typed, too. */
  function inspect() {
    const constraint = constraints[selected];
    inspector.hidden = !constraint;
    if (!constraint) return inspector.replaceChildren();
    const at = selected;
    const number = (name, value, step, write, empty = null) =>
      element("label", {}, name, element("input", {
        type: "number", step, value, "aria-label": `${name} of the ${nameOf(constraint)}`, placeholder: empty && "free",
        onchange: ({ target }) => {
          if (Number.isFinite(target.valueAsNumber)) set(at, write(target.valueAsNumber, constraints[at]));
          else if (empty) set(at, empty(constraints[at]));
        },
      }));
    const fields = [];
    if (isTimed(constraint) && !Array.isArray(constraint.seconds) && constraint.type !== "path") {
      fields.push(number("Second", constraint.seconds, NUDGE, (seconds, now) => ({ ...now, seconds: Math.min(Math.max(seconds, 0), whole) })));
    }
    if (constraint.position) {
      const axes = constraint.position.length === 2 ? ["x", "z"] : ["x", "y", "z"];
      fields.push(...axes.map((axis, k) => number(axis, constraint.position[k] ?? "", NUDGE, (value, now) => ({ ...now, position: now.position.with(k, value) }), constraint.type === "joint" && ((now) => freed(now, k)))));
    }
    if (constraint.points) {
      fields.push(element("label", { class: "wide" }, "Points x,z", element("input", {
        value: textOf(constraint.points), "aria-label": "Points of the path",
        onchange: ({ target }) => pointsOf(target.value) && set(at, { ...constraints[at], points: pointsOf(target.value) }),
      })));
    }
    fields.push(number("Weight", constraint.weight ?? 1, NUDGE, (weight, now) => ({ ...now, weight: Math.max(weight, 0) })));
    const drop = element("button", { type: "button", onclick: () => remove(at) }, `Delete the ${nameOf(constraint)}`);
    return inspector.replaceChildren(...fields, drop);
  }

  return {
    /** found: misses of the clip that is seen, in the order of the constraints; none while it is being made. */
    show(shown, seconds, found = []) {
      [constraints, whole, misses] = [shown, seconds, found];
      if (selected >= shown.length) selected = -1;
      const focused = [...tracks.querySelectorAll("button")].indexOf(document.activeElement);
      tracks.replaceChildren(...shown.map(pin));
      tracks.querySelectorAll("button")[focused]?.focus();
      if (!inspector.contains(document.activeElement)) inspect();
    },
    select(at) {
      selected = at === selected ? -1 : at;
      [...tracks.querySelectorAll("button")].forEach((button, k) => button.setAttribute("aria-pressed", String(k === selected)));
      inspect();
      return selected;
    },
  };
}

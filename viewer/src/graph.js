// The semantic graph as an indented list: motion, actions, specifics; with sliders and buttons where it can be edited.
import { element } from "./elements.js";

export const MAX_WEIGHT = 3;
const MASK = "[MASK]";
const ROLES = {
  ARG0: "who", ARG1: "what", ARG2: "what for", ARG3: "from", ARG4: "to", "ARGM-LOC": "where", "ARGM-MNR": "how",
  "ARGM-TMP": "when", "ARGM-DIR": "direction", "ARGM-ADV": "circumstance", OTHERS: "other",
};

/** All nodes in the order of their numbers: actions from 1, then the specifics. */
export function nodesOf(graph) {
  return [...graph.actions, ...graph.actions.flatMap((action) => action.arguments)];
}

/** The graph with another weight on the edge to a node. */
export function withWeight(graph, number, weight) {
  const changed = structuredClone(graph);
  nodesOf(changed)[number - 1].weight = weight;
  return changed;
}

export function isPlain(graph) {
  return nodesOf(graph).every((node) => node.weight === 1);
}

/**
 * Draw a graph into a box.
 * @param title what stands above it already; the graph's own words only stand there where they differ
 * @param edit {weigh(number, weight), change(edit), roles} where it can be edited; an edit is what /api/edit takes.
 */
export function drawGraph(box, graph, title, edit = null) {
  const nodes = nodesOf(graph);
  const list = element("ul", {});
  for (const action of graph.actions) {
    const number = nodes.indexOf(action) + 1;
    const parts = element("ul", {});
    for (const part of action.arguments) {
      parts.append(element("li", {}, row(part, nodes.indexOf(part) + 1, ROLES[part.role] ?? part.role, edit)));
    }
    if (edit) parts.append(element("li", { class: "add" }, adder("Add a detail", edit, { kind: "argument", node: number })));
    list.append(element("li", {}, row(action, number, action.negated ? "must not happen" : "action", edit), parts));
  }
  if (edit) list.append(element("li", { class: "add" }, adder("Add an action", edit, { kind: "action" })));
  const caption = graph.caption === title ? [] : [element("p", { class: "caption" }, words(graph.caption))];
  box.replaceChildren(...caption, list);
}

/** Words, hidden ones as a block. */
function words(text) {
  const parts = text.split(MASK).flatMap((part, at) => (at ? [element("span", { class: "mask" }, "hidden"), part] : [part]));
  return element("span", { class: "words" }, ...parts);
}

function row(node, number, role, edit) {
  const code = node.role ?? "ARGM-MA";
  const said = edit ? renamed(node, number, edit) : words(node.text);
  const head = [element("span", { class: node.negated ? "role not" : "role", title: code }, role), said];
  const weight = element("output", {}, shown(node.weight));
  if (!edit) {
    const bar = element("span", { class: "weight", title: "weight of the edge" }, weight);
    return element("div", { class: "node" }, ...head, ...(node.weight === 1 ? [] : [bar]));
  }
  const slider = element("input", {
    type: "range", min: 0, max: MAX_WEIGHT, step: 0.05, value: node.weight, "aria-label": `Weight of ${node.text}`,
    oninput: () => (weight.textContent = shown(slider.valueAsNumber)),
    onchange: () => edit.weigh(number, slider.valueAsNumber),
  });
  const button = (kind, sign, say) =>
    element("button", { type: "button", class: "quiet", title: say, "aria-label": say, onclick: () => edit.change({ kind, node: number }) }, sign);
  const hide = button("mask", "∅", `Hide the words ${node.text}`);
  hide.disabled = node.text.includes(MASK);
  const buttons = element("span", { class: "buttons" }, hide, button("drop", "✕", `Delete ${node.text}`));
  return element("div", { class: "node edit" }, ...head, slider, weight, buttons);
}

/** A node's words as a button that becomes a field for other words. */
function renamed(node, number, edit) {
  const say = `Other words for ${node.text}`;
  const show = element("button", { type: "button", class: "rename", title: "Other words", "aria-label": say, "data-node": number }, words(node.text));
  const field = element("input", { "aria-label": say, maxlength: 100, value: node.text.replace(MASK, "").trim() });
  let open = false;
  const close = (focus) => {
    if (!open) return;
    open = false; // before the field goes, which is a blur, too
    field.replaceWith(show);
    if (focus) show.focus();
  };
  show.addEventListener("click", () => {
    open = true;
    show.replaceWith(field);
    field.focus();
    field.select();
  });
  field.addEventListener("blur", () => close(false));
  field.addEventListener("keydown", (event) => {
    if (event.key === "Escape") event.stopPropagation(); // it is not the run's Escape
    else if (event.key !== "Enter") return;
    event.preventDefault(); // nor the form's Enter
    const text = field.value.trim();
    close(true);
    if (event.key === "Enter" && text && text !== node.text) edit.change({ kind: "replace", node: number, text });
  });
  return show;
}

function shown(weight) {
  return `×${Number(weight.toFixed(2))}`;
}

/** A small form that stays closed until it is wanted. */
function adder(title, edit, fixed) {
  const text = element("input", { "aria-label": "Words", maxlength: 100, placeholder: fixed.kind === "action" ? "waves" : "slowly" });
  const role = element("select", { "aria-label": "Kind of detail" }, ...edit.roles.map((code) => element("option", { value: code }, ROLES[code] ?? code)));
  role.value = "ARGM-MNR";
  const add = () => text.value.trim() && edit.change({ ...fixed, text: text.value, ...(fixed.kind === "argument" && { role: role.value }) });
  text.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault(); // it is not the form's Enter
    add();
  });
  const fields = fixed.kind === "argument" ? [role, text] : [text];
  return element("details", {}, element("summary", { "data-add": fixed.node ?? "action" }, title), element("span", { class: "line" }, ...fields,
    element("button", { type: "button", class: "quiet", onclick: add }, "Add")));
}

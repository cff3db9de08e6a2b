import assert from "node:assert/strict";
import { test } from "node:test";
import { createHistory, MOST_ENTRIES } from "../src/history.js";
import { createKeep } from "../src/keep.js";
import { newProject } from "../src/project.js";

const entry = (text, seed) => ({ project: newProject(text), ...(seed && { seed }) });
const words = (found) => found?.project.segments[0].text ?? null;

test("steps are undone and done again, and a new one ends what was undone", () => {
  let changes = 0;
  const history = createHistory(() => (changes += 1));
  assert.equal(history.undo(), null);
  for (const text of ["a", "b", "c"]) history.push(entry(text));
  history.push(entry("c")); // nothing new
  assert.equal(words(history.undo()), "b");
  assert.equal(words(history.undo()), "a");
  assert.equal(history.undo(), null);
  assert.equal(words(history.redo()), "b");
  history.push(entry("d"));
  assert.equal(history.canRedo, false);
  assert.equal(words(history.undo()), "b");
  assert.equal(changes, 8);
});

test("a clip's seed belongs to its step", () => {
  const history = createHistory();
  history.push(entry("a"));
  history.amend({ seed: "7" });
  assert.deepEqual(history.now, entry("a", "7"));
  assert.equal(history.canUndo, false);
});

test("it has a limit, and comes back from JSON", () => {
  const history = createHistory();
  for (let k = 0; k < MOST_ENTRIES + 20; k++) history.push(entry(`step ${k}`, String(k)));
  history.undo();
  const other = createHistory();
  other.load(JSON.parse(JSON.stringify(history)));
  assert.deepEqual(other.now, history.now);
  assert.equal(other.toJSON().entries.length, MOST_ENTRIES);
  for (const bad of [null, {}, { entries: [] }, { entries: [{}] }, { entries: [{ project: { segments: 3 } }] }]) {
    assert.throws(() => other.load(bad), /no project of kinegraph/);
  }
  assert.deepEqual(other.now, history.now);
  other.load({ entries: [{ project: newProject("x"), seed: "<b>" }], at: 99 });
  assert.deepEqual(other.now, entry("x"));
});

test("steps that are none are left out, and the others stay", () => {
  const history = createHistory();
  history.load({ entries: [entry("a", "1"), { project: { segments: 3 } }, null, entry("b", "2")], at: 3 });
  assert.equal(words(history.now), "b");
  assert.equal(words(history.undo()), "a");
});

test("of a history that has no room, the newest steps are kept", () => {
  const own = storage();
  const long = (text) => ({ project: { ...newProject(text), constraints: [{ pose: "x".repeat(300_000) }] } });
  for (const undone of [0, 11]) {
    const history = createHistory();
    for (let k = 0; k < 12; k++) history.push(long(`step ${k}`));
    for (let k = 0; k < undone; k++) history.undo();
    createKeep([() => own]).save(history);
    assert.ok(own.getItem("kinegraph").length < 2_000_001);
    const found = createHistory();
    assert.ok(createKeep([() => own]).load(found));
    assert.equal(words(found.now), words(history.now));
  }
});

function storage(most = Infinity) {
  const held = new Map();
  return {
    getItem: (key) => held.get(key) ?? null,
    removeItem: (key) => held.delete(key),
    setItem(key, text) {
      if (text.length > most) throw new Error("full");
      held.set(key, text);
    },
  };
}

test("a tab has its own, and a new one begins with the newest of all", () => {
  const [shared, first, second, third] = [storage(), storage(), storage(), storage()];
  const keep = (own) => createKeep([() => own, () => shared]);
  const history = createHistory();
  history.push(entry("a"));
  keep(first).save(history);
  history.push(entry("b"));
  keep(second).save(history);
  const loaded = (own) => {
    const found = createHistory();
    return keep(own).load(found) ? words(found.now) : null;
  };
  assert.deepEqual([first, second, third].map(loaded), ["a", "b", "b"]);
  keep(first).clear();
  assert.equal(loaded(first), null);
});

test("without storage, or with rubbish in it, work goes on", () => {
  const forbidden = () => {
    throw new Error("forbidden");
  };
  const rubbish = storage();
  rubbish.setItem("kinegraph", "{");
  for (const own of [forbidden, () => storage(10), () => rubbish]) {
    const keep = createKeep([own]);
    const history = createHistory();
    assert.equal(keep.load(history), false);
    history.push(entry("a"));
    keep.save(history);
    assert.equal(words(history.now), "a");
  }
});

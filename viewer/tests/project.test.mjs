import assert from "node:assert/strict";
import { test } from "node:test";
import { command, python } from "../src/code.js";
import { checked, cutAt, edges, inserted, kindOf, MOST_SEGMENTS, moved, newProject, projectOf, removed, segmentAt, split, wishOf, withSegment } from "../src/project.js";

const three = () => ({
  ...newProject("a"),
  segments: [{ text: "a", seconds: 2 }, { text: "b", seconds: 3 }, { text: "c", seconds: 1.5 }],
});

test("a project and its request are the same in two forms", () => {
  const graph = { caption: "a person walks", actions: [] };
  const wishes = [
    { text: "a person walks" },
    { text: "a person walks", seconds: "2.5", seed: "9223372036854775807", steps: "2", foot_fix: false },
    { text: "a person walks", graph, loop: true, in_place: true },
    { texts: ["a", graph, "c"], seconds: [2, 3, 1.5], seed: "7" },
    { concepts: [{ text: "a", weight: 1 }], method: "latent", seconds: "3", agd: "0.2,0.2" },
  ];
  for (const wish of wishes) assert.deepEqual(wishOf(projectOf(wish)), wish);
});

test("one length holds for all parts, and a seed goes before that of the project", () => {
  const project = projectOf({ texts: ["a", "b"], seconds: "3", seed: "1" });
  assert.deepEqual(project.segments.map(({ seconds }) => seconds), [3, 3]);
  assert.equal(wishOf(project, "2").seed, "2");
  assert.equal(kindOf(project), kindOf(projectOf({ texts: ["a", "b"], seconds: [3, 3], seed: "8" }, { fps: 60 })));
});

test("segments are inserted, removed, moved and cut, and the project before stays as it was", () => {
  const before = three();
  const kept = structuredClone(before);
  const words = (project) => project.segments.map(({ text, seconds }) => `${text}${seconds}`).join(" ");
  assert.equal(words(moved(before, 0, 2)), "b3 c1.5 a2");
  assert.equal(words(moved(before, 0, 3)), "a2 b3 c1.5");
  assert.equal(words(removed(before, 1)), "a2 c1.5");
  assert.equal(words(inserted(before, 1, { text: "x", seconds: 1 })), "a2 x1 b3 c1.5");
  assert.equal(words(split(before, 1, 1.24)), "a2 b1.25 b1.75 c1.5");
  assert.equal(words(split(before, 1, 0.3)), words(before));
  assert.equal(words(split(before, 2, 1)), words(before));
  assert.equal(words(withSegment(before, 2, { seconds: 9 })), "a2 b3 c9");
  assert.deepEqual(before, kept);
  assert.equal(removed(newProject("a"), 0).segments.length, 1);
  let many = before;
  for (let k = 0; k < 40; k++) many = inserted(many, 0, { text: "x", seconds: 1 });
  assert.equal(many.segments.length, MOST_SEGMENTS);
});

test("a sentence keeps its seed when others come, go or move", () => {
  const offsets = (project) => wishOf(project).seed_offsets;
  assert.equal(offsets(three()), undefined);
  const longer = inserted(three(), 1, { text: "x", seconds: 1 });
  assert.deepEqual(offsets(longer), [0, 3, 1, 2]);
  assert.deepEqual(offsets(moved(longer, 0, 3)), [3, 1, 2, 0]);
  assert.deepEqual(offsets(removed(longer, 0)), [3, 1, 2]);
  assert.deepEqual(offsets(removed(longer, 1)), undefined);
  assert.deepEqual(offsets(inserted(removed(longer, 0), 3, { text: "y", seconds: 1 })), [3, 1, 2, 4]);
  assert.deepEqual(offsets(split(three(), 1, 1.5)), [0, 1, 3, 2]);
  assert.equal(offsets(removed(removed(longer, 0), 1)).length, 2);
  assert.equal("seed_offsets" in wishOf(removed(removed(removed(longer, 0), 1), 1)), false);
  const wish = wishOf(longer, "7");
  assert.deepEqual(wishOf(projectOf(wish)), wish);
  assert.deepEqual(wishOf(checked(longer), "7"), wish);
  assert.match(python(wish, {}, "x.npz"), /pipe\.sequence\(.*seed=7, seed_offsets=\[0, 3, 1, 2\]\)/);
  assert.match(command(wish, {}, "x.npz"), /^kinegraph sequence a x b c --seed-offsets 0,3,1,2 /);
});

test("sentences are cut where a concept begins and ends", () => {
  const lengths = (project) => project.segments.map(({ seconds }) => seconds);
  assert.deepEqual(lengths(cutAt(cutAt(three(), 3, 0.8), 4, 0.8)), [2, 1, 1, 1, 1.5]);
  assert.deepEqual(lengths(cutAt(three(), 2.5, 0.8)), [2, 3, 1.5]);
  assert.equal(cutAt(three(), 0, 0.8).segments.length, 3);
  assert.equal(cutAt(three(), 6.5, 0.8).segments.length, 3);
});

test("a time has a segment", () => {
  assert.deepEqual(edges(three()), [0, 2, 5, 6.5]);
  assert.deepEqual(segmentAt(three(), 2.5), { at: 1, into: 0.5 });
  assert.equal(segmentAt(three(), 99).at, 2);
  assert.equal(segmentAt(three(), 0).at, 0);
});

test("what is no project is refused with a reason", () => {
  const bad = [
    [null, "segments"], [{}, "segments"], [{ segments: [] }, "1 to 16"], [{ segments: Array(17).fill({ text: "a" }) }, "1 to 16"],
    [{ segments: [{ text: "a".repeat(513) }] }, "no text"], [{ segments: [{ text: 3 }] }, "no text"],
    [{ segments: [{ text: "a", graph: {} }] }, "actions"], [{ segments: [{ text: "a", offset: -1 }] }, "offset"], [{ segments: [{ text: "a" }], concepts: [] }, "concepts"],
    [{ segments: [{ text: "a" }], constraints: {} }, "constraints"], [{ segments: [{ text: "a" }], layers: [{ text: "a" }] }, "layers"], [{ segments: [{ text: "a" }], sampling: 3 }, "sampling"],
  ];
  for (const [value, reason] of bad) assert.throws(() => checked(value), new RegExp(reason), JSON.stringify(value));
  const strange = { ...three(), extra: 1, segments: [{ text: "a", html: "<b>" }] };
  assert.deepEqual(checked(strange), { ...newProject("a") });
});

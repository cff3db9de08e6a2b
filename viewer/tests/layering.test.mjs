import assert from "node:assert/strict";
import { test } from "node:test";
import { fittedLayers, layerAt, layered, reach, said, SHORTEST_LAYER } from "../src/layering.js";
import { newProject, projectOf, wishOf } from "../src/project.js";
import { command, python } from "../src/code.js";

const wave = { text: "a person waves", begin: 1, end: 3, weight: 1 };

test("a layer stays inside the timeline, and keeps a length", () => {
  assert.deepEqual(layerAt(wave, "both", 0.5), { ...wave, begin: 1.5, end: 3.5 });
  assert.deepEqual(layerAt(wave, "both", -9), { ...wave, begin: 0, end: 2 });
  assert.deepEqual(layerAt(wave, "both", 9, 4), { ...wave, begin: 2, end: 4 });
  assert.equal(layerAt(wave, "begin", 9).begin, 3 - SHORTEST_LAYER);
  assert.equal(layerAt(wave, "end", -9).end, 1 + SHORTEST_LAYER);
  assert.deepEqual(layered({ ...wave, begin: -1, end: 99 }, 4), { ...wave, begin: 0, end: 4 });
  assert.deepEqual(fittedLayers([wave, { ...wave, begin: 5, end: 6 }], 2.5), [{ ...wave, end: 2.5 }]);
});

test("it counts for the whole of every sentence that it touches, as the server has it", () => {
  const edges = [0, 2, 4, 6];
  assert.deepEqual(reach(wave, edges), [0, 4]);
  assert.deepEqual(reach({ ...wave, begin: 1.5, end: 2.05 }, edges), [0, 2]);
  assert.deepEqual(reach({ ...wave, begin: 1.98, end: 2.04 }, edges), [2, 4]);
  assert.deepEqual(reach({ ...wave, begin: 0, end: 6 }, edges), [0, 6]);
});

test("it is named by its words, and by not", () => {
  assert.deepEqual([said(wave), said({ ...wave, weight: -1 }), said({ ...wave, weight: -0.5 })], ["waves", "not waves", "not waves ×0.5"]);
});

test("a project, its request and its program have them", () => {
  const project = { ...newProject("a"), segments: [{ text: "a", seconds: 4 }], layers: [wave] };
  const wish = wishOf(project, "7");
  assert.deepEqual(wish, { texts: ["a"], seconds: [4], layers: [wave], seed: "7" });
  assert.deepEqual(wishOf(projectOf(wish)), wish);
  const program = python(wish, {}, "x.npz");
  assert.match(program, /from kinegraph\.layers import Layer\nfrom kinegraph\.timeline import generate_timeline/);
  assert.match(program, /layers = \[\n {4}Layer\("a person waves", 1, 3, 1\),\n\]\nclip = generate_timeline\(pipe, \["a"\], seconds=4, seed=7, layers=layers\)/);
  assert.match(command(wish, {}, "x.npz"), /^# .*Python/);
  assert.equal("layers" in wishOf({ ...project, layers: [] }), false);
});

import assert from "node:assert/strict";
import { test } from "node:test";
import { createDragging } from "../src/dragging.js";

function setting() {
  const seen = { drafted: [], made: [], finish: null, timers: [] };
  const dragging = createDragging(
    { draft: (place) => (seen.drafted.push(place), new Promise((resolve) => (seen.finish = resolve))), make: (place) => seen.made.push(place) },
    { set: (act) => seen.timers.push(act) - 1, clear: (id) => id !== null && (seen.timers[id] = () => {}) },
  );
  const rest = () => seen.timers.splice(0).forEach((act) => act());
  return { seen, dragging, rest };
}

const soon = () => new Promise((resolve) => setTimeout(resolve));

test("places that are overtaken while a draft is drawn are left out", async () => {
  const { seen, dragging } = setting();
  dragging.to(1);
  dragging.to(2);
  dragging.to(3);
  assert.deepEqual(seen.drafted, [1]);
  seen.finish();
  await soon();
  assert.deepEqual(seen.drafted, [1, 3]);
});

test("the clip is made where the pointer rests, not before its draft was drawn, and not after it was let go", async () => {
  const { seen, dragging, rest } = setting();
  dragging.to(1);
  dragging.to(2);
  rest();
  assert.deepEqual(seen.made, []);
  seen.finish();
  await soon();
  seen.finish();
  await soon();
  rest();
  assert.deepEqual([seen.drafted, seen.made], [[1, 2], [2]]);
  dragging.to(3);
  dragging.end();
  seen.finish();
  await soon();
  rest();
  assert.deepEqual([seen.made, seen.drafted], [[2], [1, 2, 3]]);
});

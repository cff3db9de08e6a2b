import assert from "node:assert/strict";
import { test } from "node:test";
import { drawnPath, fitted, freed, handles, hasFree, middle, MOST_POINTS, pointsOf, shifted, span, straightened, textOf, translated, withHandle } from "../src/constraints.js";

const hand = { type: "joint", joint: "right_wrist", position: [0.3, 1.4, null], seconds: 2 };
const way = { type: "path", points: [[0, 0], [1, 2]] };

test("every kind has its time on the timeline", () => {
  assert.deepEqual(span(way, 6), [0, 6]);
  assert.deepEqual(span({ ...way, times: [1, 3] }, 6), [1, 3]);
  assert.deepEqual(span(hand, 6), [2, 2]);
  assert.deepEqual(span({ ...hand, seconds: [1, 2] }, 6), [1, 2]);
  assert.deepEqual([span({ type: "start" }, 6), span({ type: "end" }, 6)], [[0, 0], [6, 6]]);
});

test("times move inside the timeline, and only where they are a constraint's own", () => {
  assert.equal(shifted(hand, 1.5, 6).seconds, 3.5);
  assert.equal(shifted(hand, 99, 6).seconds, 6);
  assert.equal(shifted(hand, -99, 6).seconds, 0);
  assert.deepEqual(shifted({ ...hand, seconds: [1, 2] }, 9, 6).seconds, [5, 6]);
  assert.deepEqual(shifted({ ...way, times: [1, 3] }, 1, 6).times, [2, 4]);
  assert.equal(shifted(way, 1, 6), way);
  assert.equal(fitted([hand, way], 1.5)[0].seconds, 1.5);
  assert.equal(fitted([hand], 4)[0], hand);
});

test("places move by what is taken hold of; a free axis stays free", () => {
  assert.deepEqual(handles(hand, [9, 9, 0.7]), [[0.3, 1.4, 0.7]]);
  assert.deepEqual([hasFree(hand), hasFree(way), middle({ ...hand, seconds: [1, 2] }, 6)], [true, false, 1.5]);
  assert.deepEqual(freed(hand, 0).position, [null, 1.4, null]);
  assert.equal(freed(freed(hand, 0), 1).position[1], 1.4);
  assert.deepEqual(handles(hand), [[0.3, 1.4, 0]]);
  assert.deepEqual(withHandle(hand, 0, [1, -2, 3]).position, [1, 0, null]);
  assert.deepEqual(withHandle(way, 1, [0.12345, 9, 2]).points, [[0, 0], [0.123, 2]]);
  assert.deepEqual(translated(hand, [0.1, 0.1, 0.1]).position, [0.4, 1.5, null]);
  assert.deepEqual(translated(way, [1, 5, 1]).points, [[1, 1], [2, 3]]);
  assert.deepEqual(translated({ type: "waypoint", seconds: 1, position: [0, 1] }, [1, 1, 1]).position, [1, 2]);
});

test("what is drawn becomes a path from the origin with few points, near what was drawn", () => {
  const arc = Array.from({ length: 200 }, (_, k) => [2 * Math.sin(k / 60), 2 - 2 * Math.cos(k / 60)]);
  const { points } = drawnPath(arc);
  assert.deepEqual(points[0], [0, 0]);
  assert.ok(points.length > 3 && points.length <= MOST_POINTS, String(points.length));
  assert.deepEqual(points.at(-1), arc.at(-1).map((value) => Math.round(value * 1000) / 1000));
  assert.equal(drawnPath([[2, 0], [3, 3]]).points.length, 3);
  const far = ([x, z], line) => Math.min(...line.slice(1).map((b, k) => {
    const a = line[k];
    const t = Math.min(1, Math.max(0, ((x - a[0]) * (b[0] - a[0]) + (z - a[1]) * (b[1] - a[1])) / ((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2)));
    return Math.hypot(x - a[0] - t * (b[0] - a[0]), z - a[1] - t * (b[1] - a[1]));
  }));
  const line = straightened(arc, 0.04);
  assert.ok(Math.max(...arc.map((point) => far(point, line))) <= 0.04 + 1e-9);
  const noise = Array.from({ length: 300 }, (_, k) => [k / 50, (k * 7919) % 13 / 10]);
  assert.ok(drawnPath(noise).points.length <= MOST_POINTS);
});

test("a path can be typed", () => {
  assert.deepEqual(pointsOf(" 0,0  1,2.5 "), [[0, 0], [1, 2.5]]);
  for (const bad of ["", "0,0", "0,0 1", "0,0 a,b", "0,0 1,2,3"]) assert.equal(pointsOf(bad), null, bad);
  assert.deepEqual(pointsOf(textOf([[0, 0], [1, -2]])), [[0, 0], [1, -2]]);
});

import assert from "node:assert/strict";
import { test } from "node:test";
import { chosen, isSeldom, recognised, replaced, said, search, shortOf } from "../src/phrases.js";

const action = (example, clips = 1, wordings = []) => ({ kind: "action", example, clips, wordings: [example.replace("a person ", ""), ...wordings] });
const style = (wording, clips = 1) => ({ kind: "style", example: `a person walks ${wording}`, clips, wordings: [wording] });
const phrases = [
  action("a person runs", 9), action("a person runs, then stops", 8), action("a person raises the left hand", 7, ["lifts the left arm"]),
  action("a person gives a thumbs up with the right hand", 6), style("in a normal way", 99), style("angrily", 3), style("in a tired way", 4),
];

test("few examples show much: one of each verb, none too long", () => {
  assert.deepEqual(chosen(phrases, "action", 9).map(shortOf), ["runs", "raises the left hand"]);
  assert.deepEqual(chosen(phrases, "style", 9).map(shortOf), ["in a tired way", "angrily"]);
  assert.deepEqual(chosen(phrases, "action", 1).map(shortOf), ["runs"]);
});

test("what is mostly recognised comes first, where that was measured", () => {
  const measured = phrases.map((phrase) => ({ ...phrase, recognised: { "a person runs": 0.2, "a person raises the left hand": 0.834 }[phrase.example] ?? null }));
  assert.deepEqual(chosen(measured, "action", 9).map(shortOf), ["raises the left hand", "runs, then stops"]);
  assert.deepEqual(search(measured, "run").map(shortOf), ["runs, then stops", "runs"]);
  const [runs, , raises, thumbs] = measured;
  assert.deepEqual([runs, raises, thumbs].map(recognised), ["20 %", "83 %", ""]);
  assert.deepEqual([runs, raises, thumbs, phrases[0]].map(isSeldom), [true, false, false, false]);
});

test("a search finds beginnings of words, in other wordings, too", () => {
  const found = (query) => search(phrases, query).map(shortOf);
  assert.deepEqual(found("run"), ["runs", "runs, then stops"]);
  assert.deepEqual(found("LIFT arm"), ["raises the left hand"]);
  assert.deepEqual(found("ised"), []);
  assert.deepEqual(found(" ,"), []);
});

test("an action is a sentence; a style goes behind one, in place of another", () => {
  assert.equal(said("a person bows", phrases[0], phrases), "a person runs");
  assert.equal(said("a person bows.", phrases[5], phrases), "a person bows angrily");
  assert.equal(said("a person bows in a tired way", phrases[5], phrases), "a person bows angrily");
  assert.equal(said("", phrases[5], phrases), "a person walks angrily");
});

test("known words take the place of unknown ones", () => {
  assert.equal(replaced("a person walks and Juggles", "juggles", "bows"), "a person walks and bows");
  assert.equal(replaced("something else", "juggles", "bows"), "a person bows");
});

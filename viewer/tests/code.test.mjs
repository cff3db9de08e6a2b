import assert from "node:assert/strict";
import { test } from "node:test";
import { command, literal, python, quoted } from "../src/code.js";

const wish = { text: "a person walks", seconds: "4", seed: "7" };

test("values are written as Python writes them", () => {
  assert.equal(literal({ a: [1, null, true, 'x"y'] }), '{"a": [1, None, True, "x\\"y"]}');
  assert.equal(quoted("it's"), "'it'\\''s'");
  assert.equal(quoted("walk_7.glb"), "walk_7.glb");
});

test("a plain clip", () => {
  assert.equal(command(wish, {}, "walk.glb"), "kinegraph generate 'a person walks' --seconds 4 --seed 7 -o walk.glb\n");
  assert.equal(
    python(wish, {}, "walk.glb"),
    'from kinegraph import MotionPipeline\n\npipe = MotionPipeline.load()\n' +
      'clip = pipe.generate("a person walks", seconds=4, seed=7)\nclip.save("walk.glb")\n',
  );
});

test("all that a file can be asked for", () => {
  const asked = { ...wish, steps: "8, 8,10", foot_fix: false, loop: true, in_place: true };
  const output = { fps: 60, root: true, names: "mixamo" };
  assert.equal(
    command(asked, output, "walk.glb"),
    "kinegraph generate 'a person walks' --seconds 4 --seed 7 --steps 8,8,10 --no-foot-fix --loop --in-place --fps 60 --root --names mixamo -o walk.glb\n",
  );
  const program = python(asked, output, "walk.glb");
  assert.match(program, /steps=\(8, 8, 10\), foot_fix=False/);
  assert.match(program, /clip = clip\.looped\(foot_fix=False\)\.in_place\(\)\nclip\.resampled\(60\)\.save\("walk\.glb", names="mixamo", root=True\)/);
  assert.match(python(asked, output, "walk.npz"), /clip\.resampled\(60\)\.save\("walk\.npz"\)/);
  assert.match(python(asked, output, "walk.glb", "hero.vrm"), /clip\.onto\("hero\.vrm", fps=60, root=True\)\.save\("walk\.glb"\)/);
  assert.match(command(asked, output, "walk.glb", "my hero.vrm"), /--root --character 'my hero\.vrm' -o walk\.glb/);
});

test("constraints are decoded from what the request says", () => {
  const constraints = [{ type: "waypoint", seconds: 2, position: [0.5, 1] }];
  const program = python({ ...wish, constraints }, {}, "x.bvh");
  assert.match(program, /import constraints_json\n\npipe[^]*decode\(\[\n {4}\{"type": "waypoint", "seconds": 2, "position": \[0\.5, 1\]\},\n\]\)\nclip = pipe\.generate\([^]*constraints=constraints\)/);
  const scene = { texts: ["a", "b"], seconds: [2, 3], seed: "1", constraints };
  assert.match(python(scene, {}, "x.bvh"), /clip = generate_timeline\(pipe, \["a", "b"\], seconds=\(2, 3\), seed=1, constraints=constraints\)/);
  assert.match(command(scene, {}, "x.bvh"), /^# /);
  assert.match(command({ ...wish, constraints }, {}, "x.bvh"), /^cat > constraints\.json <<'END'\n\[.*\]\nEND\nkinegraph generate .* -o x\.bvh --constraints constraints\.json\n$/);
});

test("concepts, sequences and graphs", () => {
  const mixed = { concepts: [{ text: "walks", weight: 1 }, { text: "runs: fast", weight: -0.5 }], method: "latent", seed: "1" };
  assert.equal(command(mixed, {}, "x.bvh"), "kinegraph compose --and walks --not 'runs: fast:0.5' --method latent --seed 1 -o x.bvh\n");
  assert.match(python(mixed, {}, "x.bvh"), /import Concept, MotionPipeline[^]*pipe\.compose\(\[Concept\("walks"\), Concept\("runs: fast", -0\.5\)\], method="latent", seed=1\)/);
  const sequence = { texts: ["a", "b"], seconds: [2, 3], seed: "1" };
  assert.equal(command(sequence, {}, "x.bvh"), "kinegraph sequence a b --seconds 2,3 --seed 1 -o x.bvh\n");
  assert.match(python(sequence, {}, "x.bvh"), /pipe\.sequence\(\["a", "b"\], seconds=\(2, 3\), seed=1\)/);
  const graph = { caption: "it's", actions: [] };
  assert.match(command({ graph, seed: "1" }, {}, "x.bvh"), /generate --graph - --seed 1 -o x\.bvh <<'END'\n\{"caption":"it's","actions":\[\]\}\nEND/);
  assert.match(python({ texts: ["a", graph] }, {}, "x.bvh"), /graph = SemanticGraph[^]*\["a", graph\]/);
  assert.match(command({ texts: ["a", graph] }, {}, "x.bvh"), /^# /);
});

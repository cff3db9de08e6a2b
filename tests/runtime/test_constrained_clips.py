"""Clips under constraints: nearer to what is wanted, the same clip without weight, and refused before anything runs."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path as Folder
from typing import Any

import numpy as np
import pytest

from kinegraph import Cancelled, Clip, Concept, InvalidInputError, MotionPipeline, StepInfo
from kinegraph.bundle.manifest import decode_manifest, encode_manifest
from kinegraph.constrained_denoising import STALL_STEPS, STALLED, stalls
from kinegraph.constraints import EndPose, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.motion.skeleton import PELVIS, bone_lengths
from support.toy import TOY_BUNDLE

pytest.importorskip("spacy")

FEW: dict[str, Any] = {"steps": 4, "seconds": 2, "seed": 3}
WALK, WAVE = "a person walks forward", "a person waves the right hand"
ASIDE = Waypoint(2.0, (0.4, 1.2))


@pytest.fixture(scope="module")
def walk(toy: MotionPipeline) -> Clip:
    return toy.generate(WALK, **FEW)


def wanted_of(walk: Clip, toy: MotionPipeline) -> dict[str, Any]:
    other = toy.generate(WAVE, steps=4, seconds=2, seed=9)
    return {
        "path": Path(np.array([[0.0, 0.0], [0.2, 0.8], [0.6, 1.5]])),
        "waypoint": ASIDE,
        "hand": JointTarget("right hand", (None, 1.5, None), 1.0),
        "interval": JointTarget("left hand", (None, 1.2, None), (0.8, 1.2)),
        "keyframe": Keyframe.of(other, 1.0, anywhere=True),
        "start": StartPose(other),
        "end": EndPose(other),
        "loop": Loop(),
    }


@pytest.mark.parametrize("name", ["path", "waypoint", "hand", "interval", "keyframe", "start", "end", "loop"])
def test_a_constraint_is_met(toy: MotionPipeline, walk: Clip, name: str) -> None:
    wanted = wanted_of(walk, toy)[name]
    without = toy.generate(WALK, constraints=[dataclasses.replace(wanted, weight=0.0)], **FEW)
    np.testing.assert_array_equal(without.joints, walk.joints)  # bit for bit
    pulled = toy.generate(WALK, constraints=[wanted], constraint_fix=False, **FEW)
    closed = toy.generate(WALK, constraints=[wanted], **FEW)
    (before,), (by_energy,), (after,) = without.misses, pulled.misses, closed.misses
    assert by_energy.metres < 0.5 * before.metres or by_energy.metres < 0.02
    assert after.metres <= 0.01 and after.worst <= 0.05
    lengths = bone_lengths(closed.joints)
    assert np.abs(lengths - lengths[0]).max() < 1e-4
    np.testing.assert_allclose(closed.joints[0, PELVIS, [0, 2]], 0.0, atol=5e-3)


def test_no_weight_of_all_constraints_is_the_clip_without_them(toy: MotionPipeline, walk: Clip) -> None:
    for constraints in (None, [], ()):
        assert toy.generate(WALK, constraints=constraints, **FEW).joints.tobytes() == walk.joints.tobytes()
    clip = toy.generate(WALK, constraints=[ASIDE], constraint_weight=0.0, **FEW)
    assert clip.joints.tobytes() == walk.joints.tobytes() and clip.misses[0].metres > 0.05
    assert walk.misses == ()


def test_a_clip_that_was_looped_or_set_in_place_tells_no_misses(toy: MotionPipeline) -> None:
    clip = toy.generate(WALK, constraints=[ASIDE], **FEW)
    assert clip.misses and clip.looped().misses == () == clip.in_place().misses


def test_compositions_takes_and_batches_take_constraints(toy: MotionPipeline) -> None:
    composed = toy.compose([Concept(WALK), Concept(WAVE)], constraints=[ASIDE], **FEW)
    (one, two) = toy.takes(WALK, 2, constraints=[ASIDE], **FEW)
    alone = toy.generate(WALK, constraints=[ASIDE], **FEW)
    assert one.joints.tobytes() == alone.joints.tobytes() != two.joints.tobytes()
    for clip in (composed, one, two, *toy.batch([WAVE], constraints=[ASIDE], **FEW)):
        assert clip.misses[0].metres < 0.01 and clip.misses[0].what == "waypoint at 2 s"
    with pytest.raises(InvalidInputError, match="shared_run"):
        toy.takes(WALK, 2, constraints=[ASIDE], shared_run=True, **FEW)


def test_every_step_is_reported_and_any_can_be_the_last(toy: MotionPipeline) -> None:
    seen: list[StepInfo] = []
    toy.generate(WALK, constraints=[ASIDE], on_step=seen.append, **FEW)
    assert [info.done for info in seen[:12]] == list(range(1, 13))
    assert {info.total for info in seen} == {seen[-1].done} and seen[-1].level == "constraints"
    for last in (2, 12, 13):
        calls: list[int] = []

        def stop(info: StepInfo, last: int = last, calls: list[int] = calls) -> bool:
            calls.append(info.done)
            return info.done < last

        with pytest.raises(Cancelled, match=f"step {last} of"):
            toy.generate(WALK, constraints=[ASIDE], on_step=stop, **FEW)
        assert calls[-1] == last


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"constraints": 3}, "constraints is a list"),
        ({"constraints": [3]}, r"constraints\[0\] is 3"),
        ({"constraints": [Waypoint(2.5, (0, 1))]}, "after the end of the clip"),
        ({"constraints": [ASIDE], "constraint_weight": -1}, "constraint_weight must be"),
        ({"constraints": [ASIDE], "constraint_weight": float("nan")}, "constraint_weight must be"),
        ({"constraints": [ASIDE], "constraint_fix": 1}, "constraint_fix must be"),
    ],
)
def test_bad_constraints_are_refused_before_a_step(toy: MotionPipeline, options: dict[str, Any], words: str) -> None:
    steps: list[StepInfo] = []
    with pytest.raises(InvalidInputError, match=words):
        toy.generate(WALK, on_step=steps.append, **FEW, **options)
    assert not steps


def test_what_nobody_can_do_is_told_with_the_miss(toy: MotionPipeline) -> None:
    clip = toy.generate(WALK, constraints=[Waypoint(2.0, (0.0, 30.0))], **FEW)
    assert clip.misses[0].metres > 1.0 and np.isfinite(clip.joints).all()
    assert "nobody is faster" in clip.notes[0] and "missed by" in clip.notes[1]


def test_a_bundle_without_gradients_refuses(tmp_path: Folder) -> None:
    folder = tmp_path / "bundle"
    shutil.copytree(TOY_BUNDLE, folder)
    manifest = decode_manifest((folder / "manifest.json").read_bytes())
    gone = [name for name in manifest.files if name.endswith("_vjp.onnx")]
    for name in gone:
        (folder / name).unlink()
    kept = {
        part: {name: value for name, value in getattr(manifest, part).items() if name not in gone}
        for part in ("files", "operators")
    }
    (folder / "manifest.json").write_bytes(encode_manifest(dataclasses.replace(manifest, **kept)))
    pipe = MotionPipeline.load(folder, threads=1)
    with pytest.raises(InvalidInputError, match="add_gradients"):
        pipe.generate(WALK, constraints=[ASIDE], **FEW)
    with pytest.raises(InvalidInputError, match="add_gradients"):
        pipe.edit(Clip(np.zeros((20, 22, 3), dtype=np.float32), 20.0, 1, WALK, "toy 1"), WALK, keep="legs")


def test_a_descent_that_hardly_goes_on_ends() -> None:
    steep = [0.5**step for step in range(STALL_STEPS + 3)]
    assert not stalls(steep) and not stalls([1.0] * STALL_STEPS)
    assert stalls([*steep, *[steep[-1]] * STALL_STEPS])
    assert not stalls([1.0, *[STALLED - 0.01] * STALL_STEPS]) and stalls([1.0, *[STALLED + 0.01] * STALL_STEPS])

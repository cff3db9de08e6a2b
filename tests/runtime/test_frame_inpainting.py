"""Known frames and joints held in skeleton space: a loop by hand, poses, edits, in-betweens, and what is refused."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path as Folder
from typing import Any

import numpy as np
import pytest

pytest.importorskip("spacy")

from kinegraph import Clip, MotionPipeline
from kinegraph.bundle.contract import FRAMES
from kinegraph.cli import main
from kinegraph.constrained_denoising import Wanted, told_clip
from kinegraph.constraints import EndPose, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.diffusion.sampling import StepInfo, ddim_coefficients
from kinegraph.errors import Cancelled, InvalidInputError
from kinegraph.formats import read
from kinegraph.frame_denoising import FrameSampler, group, ungroup
from kinegraph.frame_inpainting import HeldFrames, ReachedFrames, anchors_of, encode_frames, sample_known
from kinegraph.intervals import Interval
from kinegraph.keeping import PARTS
from kinegraph.motion.energies import to_own_frames
from kinegraph.motion.features import features_from_joints, joints_from_features
from kinegraph.motion.known_features import Anchor, KnownFeatures
from kinegraph.motion.reaching import MAX_REACH
from kinegraph.motion.skeleton import JOINT_INDEX, PELVIS, facing_angle, start_at_origin
from kinegraph.options import resolve_options
from support.motions import walk as walking

WALK, WAVE, BOW = "a person walks forward", "a person waves the right hand", "a person bows"
HELD: dict[str, Any] = {"seed": 3, "space": FRAMES}
ALONE: dict[str, Any] = {**HELD, "constraint_fix": False, "foot_fix": False}
"""What sampling itself does: nothing is mended in the joints."""
WRIST = JOINT_INDEX["right_wrist"]
EXACT = 5e-3
"""Metres: bones are made rigid, by which the whole body shares what the new parts lack."""


@pytest.fixture(scope="module")
def walk(toy: MotionPipeline) -> Clip:
    return toy.generate(WALK, seconds=2.2, **HELD)


@pytest.fixture(scope="module")
def bow(toy: MotionPipeline) -> Clip:
    return toy.generate(BOW, seconds=2, **HELD)


def sampler_of(toy: MotionPipeline) -> FrameSampler:
    sampler = toy.in_space(FRAMES).sampler
    assert isinstance(sampler, FrameSampler)
    return sampler


def distance(joints: np.ndarray, others: np.ndarray) -> float:
    return float(np.linalg.norm(joints - others, axis=-1).max())


def test_sampling_is_the_loop_of_mdm(toy: MotionPipeline) -> None:
    """The clean frames of every step are overwritten where they are known, written out one step at a time."""
    sampler, steps = sampler_of(toy), 5
    options = replace(resolve_options(toy.manifest, seed=4, space=FRAMES), frames=42)
    known = KnownFeatures.nothing(44).with_poses(walking(9), 0).with_poses(walking(8), 34)
    known = known.with_poses(walking(42), 0, PARTS["left arm"], moving=False)
    conditions = toy.encoder.attend(toy.encoder.encode_text([toy.parse(WAVE)]))
    ddim, alphas = ddim_coefficients(sampler.schedule, steps), sampler.schedule.alphas_cumprod
    predict = sampler.predictor(conditions, None, [replace(options, frames=44)], FRAMES, ddim, None)
    wanted = group(known.values[None], sampler.manifest)
    mask = known.known.reshape(wanted.shape)
    x = np.random.Generator(np.random.PCG64(4)).standard_normal(wanted.shape[1:], dtype=np.float32)[None]
    for step, time in enumerate(ddim.timesteps):
        now, after = alphas[time], alphas[time - 200] if time >= 200 else 1.0  # 5 of 1,000 steps, the last one clean
        clean = (x - np.sqrt(1 - now) * predict(x, step)) / np.sqrt(now)
        clean[mask] = wanted[mask]
        noise = (x - np.sqrt(now) * clean) / np.sqrt(1 - now)
        x = (np.sqrt(after) * clean + np.sqrt(1 - after) * noise).astype(np.float32)
    x[mask] = wanted[mask]
    held = HeldFrames.of(known, sampler.manifest)
    found = sample_known(sampler, conditions, None, replace(options, steps={FRAMES: steps}), held)
    np.testing.assert_allclose(found, x, atol=1e-4)
    free = sampler.sample(conditions, None, [replace(options, steps={FRAMES: steps})])
    assert np.abs(found - free)[~mask].max() > 0.01, "what is made anew does not heed what is known"


def test_what_is_held_leads_the_root_and_keeps_the_rest(toy: MotionPipeline) -> None:
    sampler = sampler_of(toy)
    clean = encode_frames(walking(24), sampler)
    known = KnownFeatures.nothing(24).with_poses(walking(4), 0).with_anchor(Anchor(20, (1.0, 2.0), 0.5))
    held = HeldFrames.of(known, sampler.manifest)
    once = held(clean)
    (joints,) = toy.in_space(FRAMES).decoder.joints(once, [24], FRAMES)
    np.testing.assert_allclose(joints[20, PELVIS, [0, 2]], (1.0, 2.0), atol=1e-3)
    np.testing.assert_allclose(held(once), once, atol=1e-4)
    np.testing.assert_allclose(once[held.mask], held.tokens[held.mask])


def test_an_in_between_begins_and_ends_as_asked(toy: MotionPipeline, walk: Clip, bow: Clip) -> None:
    clip = toy.inbetween(walk, bow, 2.1, WALK, **ALONE)
    assert clip.frames == 42 and [miss.what for miss in clip.misses] == ["start pose", "end pose"]
    assert max(miss.worst for miss in clip.misses) < EXACT
    assert distance(clip.joints[:4], StartPose(walk).frames(20.0)) < EXACT
    mended = toy.inbetween(walk, bow, 2.1, WALK, **HELD)
    assert max(miss.worst for miss in mended.misses) < EXACT
    # the text still says what happens between
    other = toy.inbetween(walk, bow, 2.1, WAVE, **ALONE)
    assert distance(other.joints[10:30], clip.joints[10:30]) > 0.05


def test_a_placed_end_is_where_it_is(toy: MotionPipeline, walk: Clip) -> None:
    poses = walk.joints[5], walk.joints[36]
    for text in (WALK, BOW):
        clip = toy.inbetween(*poses, 1.6, text, placed=True, **ALONE)
        assert clip.misses[-1].what.startswith("keyframe") and clip.misses[-1].worst < EXACT
        way = np.linalg.norm((poses[1] - poses[0])[PELVIS, [0, 2]])
        assert np.linalg.norm(clip.joints[-1, PELVIS, [0, 2]]) == pytest.approx(way, abs=EXACT)
        steps = np.linalg.norm(np.diff(clip.joints[:, PELVIS], axis=0), axis=-1)
        assert steps.max() < 0.25, "the way is made in one leap"


def test_legs_are_kept_in_the_world_and_the_rest_is_new(toy: MotionPipeline, walk: Clip) -> None:
    edited, before = toy.edit(walk, WAVE, keep="legs", **HELD), start_at_origin(walk.joints)
    legs, wrist = list(PARTS["legs"]), JOINT_INDEX["right_wrist"]
    assert distance(edited.joints[:, legs], before[:, legs]) < EXACT
    # not mended, the pelvis shares what bones of the toy's poor arms and back lack
    alone = toy.edit(walk, WAVE, keep="legs", **ALONE)
    assert distance(alone.joints[:, legs], before[:, legs]) < 0.04
    assert distance(edited.joints[:, wrist], before[:, wrist]) > 0.1
    assert edited.misses[-1].what == "what is kept" and edited.misses[-1].worst < EXACT


def test_spans_are_kept_where_they_are(toy: MotionPipeline, walk: Clip) -> None:
    edited, before = toy.edit(walk, BOW, keep=[(0.8, 1.3), (1.9, 2.2)], **ALONE), start_at_origin(walk.joints)
    for span in (slice(16, 26), slice(38, 44)):
        assert distance(edited.joints[span], before[span]) < EXACT
    assert distance(edited.joints[4:14], before[4:14]) > 0.05


def test_an_arm_comes_along(toy: MotionPipeline, walk: Clip) -> None:
    waved = toy.generate(WAVE, seconds=2.2, **HELD)
    edited = toy.edit(waved, WALK, keep=["right arm"], **HELD)
    arm = list(PARTS["right arm"])
    own, before = (to_own_frames(clip.joints.astype(np.float64))[0][:, arm] for clip in (edited, waved))
    assert np.linalg.norm(own - before, axis=-1).mean() < 0.02
    assert np.linalg.norm(edited.joints[-1, PELVIS] - waved.joints[-1, PELVIS]) > 0.3


def test_less_strength_stays_nearer(toy: MotionPipeline, walk: Clip) -> None:
    own = to_own_frames(walk.joints.astype(np.float64))[0]
    away = [
        np.linalg.norm(to_own_frames(edited.joints.astype(np.float64))[0] - own, axis=-1).mean()
        for edited in (toy.edit(walk, WAVE, keep="left leg", strength=share, **HELD) for share in (0.3, 1.0))
    ]
    assert away[0] < away[1]


def test_poses_are_held_in_compositions_takes_and_streams(toy: MotionPipeline, walk: Clip, bow: Clip) -> None:
    pose = Keyframe(1.0, bow.joints[20], anywhere=True)
    composed = toy.compose([WALK, WAVE], seconds=2.2, constraints=[StartPose(walk), pose], **ALONE)
    taken = toy.takes(WALK, 2, seconds=2.2, constraints=[pose, EndPose(bow)], **ALONE)
    for clip in (composed, *taken):
        assert len(clip.misses) == 2 and max(miss.worst for miss in clip.misses) < EXACT
    assert distance(taken[0].joints, taken[1].joints) > 0.01
    frames = np.array(list(itertools.islice(toy.stream([WALK, BOW], seconds=1.2, **HELD), 48)))
    steps = np.linalg.norm(np.diff(frames, axis=0), axis=-1).max(axis=1)
    assert frames.shape == (48, 22, 3) and steps[22:26].max() < 0.4


def test_a_path_and_a_waypoint_are_held_while_the_body_sways_between(toy: MotionPipeline) -> None:
    path = Path([(0, 0), (0.4, 1.0), (-0.3, 2.0)])
    options = {**ALONE, "seconds": 2.2}
    clip, plain = toy.generate(WALK, constraints=[path], **options), toy.generate(WALK, **options)
    places = path.positions(np.arange(44) / 20, 43 / 20)
    # joints are the least squares of positions and velocities, and bones are made rigid, so to a centimetre
    off = np.linalg.norm(clip.joints[:, PELVIS, [0, 2]] - places, axis=-1)
    assert off[[5, 20, 43]].max() < 0.06 and off.mean() < 0.06
    assert np.linalg.norm(plain.joints[:, PELVIS, [0, 2]] - places, axis=-1).mean() > 0.15
    mended = toy.generate(WALK, constraints=[path], seconds=2.2, **HELD)
    assert mended.misses[0].metres < 0.01
    waypoint = Waypoint(1.0, (0.5, 0.9), heading=30)
    at = toy.generate(WALK, constraints=[waypoint], **options).joints[20]
    assert np.linalg.norm(at[PELVIS, [0, 2]] - [0.5, 0.9]) < 0.06
    assert float(facing_angle(at[None])[0]) == pytest.approx(np.radians(30), abs=0.2)


def test_a_hand_is_held_at_a_place_and_a_loop_closes(toy: MotionPipeline, walk: Clip) -> None:
    options = {**ALONE, "seconds": 2.2}
    plain = toy.generate(WALK, **options).joints
    place = plain[30, WRIST] + np.array([0.12, 0.15, 0.1])
    target = JointTarget("right hand", tuple(place.tolist()), 1.5)
    for constraint in (target, Loop()):
        held = toy.generate(WALK, constraints=[constraint], **options)
        free = toy.generate(WALK, constraints=[constraint], constraint_weight=0, **options)
        np.testing.assert_array_equal(free.joints, plain)
        assert held.misses[0].metres < 0.3 * free.misses[0].metres, constraint
        assert toy.generate(WALK, constraints=[constraint], seconds=2.2, **HELD).misses[0].metres < 0.01
    # beside poses that are known, which go before it, and on a timeline
    between = toy.inbetween(walk, walk, 2.2, WALK, constraints=[target], **HELD)
    begins = toy.inbetween(walk, walk, 2.2, WALK, **HELD)
    assert between.misses[-1].metres < 0.02 and between.misses[0].metres < begins.misses[0].metres + 0.01
    clip = toy.timeline([Interval(WALK, 0, 1.2), Interval(BOW, 1.2, 2.4)], constraints=[target], **HELD)
    assert clip.misses[0].metres < 0.02


def test_clean_frames_are_brought_to_a_place_once_and_a_body_walks_to_what_is_far(toy: MotionPipeline) -> None:
    manifest = toy.manifest
    joints = walking(44)
    for ahead in (0.1, 1.5):
        target = JointTarget("right hand", tuple((joints[30, WRIST] + [0, 0.1, ahead]).tolist()), 1.5)
        reached = ReachedFrames(Wanted((target,), 1.0, fix=True, strict=False), 44, manifest)
        once = reached(group(features_from_joints(joints)[None], manifest))
        moved = joints_from_features(ungroup(once, manifest)[0])
        assert np.linalg.norm(moved[30, WRIST] - np.array(target.position)) < 0.03
        assert np.linalg.norm(moved[0] - start_at_origin(joints)[0], axis=-1).max() < 0.02, "the start goes along"
        walked = moved[30, PELVIS, 2] - start_at_origin(joints)[30, PELVIS, 2]
        assert walked == pytest.approx(max(ahead - MAX_REACH, 0.0), abs=0.03)
        np.testing.assert_allclose(reached(once), once, atol=0.05)


def test_a_path_is_held_at_its_own_moments() -> None:
    anchors = anchors_of(Path([(0, 0), (0, 1)], times=[1.0, 2.0], heading="along"), 60, 20)
    assert [anchor.frame for anchor in anchors] == [20, 25, 30, 35, 40]
    np.testing.assert_allclose([anchor.position for anchor in anchors], [(0, z) for z in (0, 0.25, 0.5, 0.75, 1)])
    assert all(anchor.heading == 0 for anchor in anchors)
    assert anchors_of(Path([(0, 0), (0, 1)], times=[4.0, 5.0]), 60, 20) == []
    # without headings, along a corner to the left, in the turns of a person
    corner = anchors_of(Path([(0, 0), (0, 2), (2, 2)]), 81, 20)
    headings = np.array([anchor.heading for anchor in corner])
    assert headings[0] == 0 and headings[-1] == pytest.approx(np.pi / 2)
    assert (np.diff(headings) >= -1e-9).all() and np.diff(headings).max() < 0.5
    assert all(anchor.heading is None for anchor in anchors_of(Path([(1, 1), (1, 1)]), 60, 20))


def test_a_timeline_walks_a_path_with_an_arm_of_its_own(toy: MotionPipeline) -> None:
    timeline = [Interval(WALK, 0, 2.4, ("legs", "torso")), Interval(WAVE, 0.4, 2.0, ("right arm",))]
    path = Path([(0, 0), (0.5, 1.2), (0, 2.2)])
    clip = toy.timeline(timeline, constraints=[path], **HELD)
    assert clip.misses[0].metres < 0.02 and clip.joints.shape == (48, 22, 3)
    held = toy.timeline(timeline, constraints=[path], constraint_fix=False, **HELD)
    assert held.misses[0].metres < 0.06, "it is corrected in the joints, and not held"
    alone = toy.generate(WALK, seconds=2.4, constraints=[path], **HELD)
    of_one = toy.timeline([Interval(WALK, 0, 2.4)], constraints=[path], **HELD)
    np.testing.assert_array_equal(of_one.joints, alone.joints)
    without = toy.timeline(timeline, **HELD)
    unweighed = toy.timeline(timeline, constraints=[path], constraint_weight=0, **HELD)
    np.testing.assert_array_equal(unweighed.joints, without.joints)
    assert unweighed.misses[0].metres > 0.1
    # longer than what the bundle makes at a time
    long = [Interval(WALK, 0, 6), Interval(BOW, 6, 12)]
    clip = toy.timeline(long, constraints=[Waypoint(11, (0, 1.5))], **HELD)
    assert clip.misses[0].metres < 0.02
    with pytest.raises(InvalidInputError, match="constraints on intervals are for"):
        toy.timeline([Interval(WALK, 0, 2)], constraints=[path])


def test_no_weight_is_no_pose(toy: MotionPipeline, walk: Clip, bow: Clip) -> None:
    plain = toy.generate(WALK, seconds=2, **HELD)
    for options in ({"constraint_weight": 0}, {"constraints": [StartPose(bow, weight=0)]}):
        clip = toy.generate(WALK, seconds=2, **{"constraints": [StartPose(bow)], **HELD, **options})
        np.testing.assert_array_equal(clip.joints, plain.joints)
    assert clip.misses[0].metres > 0


def test_what_cannot_be_held_is_told(toy: MotionPipeline, walk: Clip) -> None:
    """Bones of another body, and two poses that no step leads between."""
    tall = replace(walk, joints=walk.joints * 1.3)
    edited = toy.edit(tall, BOW, keep=[(0.0, 1.0)], **ALONE)
    assert edited.misses[-1].metres > 0.05 and "what is kept: missed by" in edited.notes[-1]
    for pose in (StartPose(tall), EndPose(tall)):  # closing what bones leave open would lead away
        options = {"seconds": 2, "constraints": [pose], "foot_fix": False, **HELD}
        mended, held = (toy.generate(WALK, constraint_fix=fix, **options) for fix in (True, False))
        assert mended.misses[0].metres <= held.misses[0].metres
    strict = Wanted((Keyframe(1.0, tall.joints[20]),), 1.0, True, strict=True)
    with pytest.raises(InvalidInputError, match="keyframe at 1 s: missed by"):
        told_clip(walk.joints, strict, resolve_options(toy.manifest), WALK, toy.manifest)
    far = Keyframe(1.0, walk.joints[20] + np.array([0.0, 0.0, 1.0], dtype=np.float32))
    clip = toy.edit(walk, BOW, keep="legs", constraints=[far], **ALONE)
    assert clip.misses[0].metres > 0.5 and "keyframe at 1 s: missed by" in clip.notes[-1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"keep": []}, "keep is a list"),
        ({"keep": "tail"}, "the parts are legs"),
        ({"keep": [(0.0, 2.2)]}, "keep names all of the clip"),
        ({"keep": ["legs", "arms", "head", "torso"]}, "keep names all of the clip"),
        ({"keep": [(1.0, 9.0)]}, "must rise from 0 to 2.2 s"),
        ({"keep": "legs", "strength": 0}, "strength must be"),
        ({"keep": "legs", "constraints": [JointTarget("head", (0, 1, 0), 9.0)]}, "9 s"),
        ({"keep": "legs", "constraint_fix": 3}, "constraint_fix"),
        ({"keep": "legs", "constraint_weight": -1}, "constraint_weight must be"),
        ({"keep": "legs", "space": "time"}, "space must be one of latent, frames"),
        ({"keep": "legs", "steps": (3, 3)}, "steps must be one number or 1"),
    ],
)
def test_bad_edits_are_refused(toy: MotionPipeline, walk: Clip, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        toy.edit(walk, WAVE, **{**HELD, **options})


def test_bad_in_betweens_are_refused(toy: MotionPipeline, walk: Clip, bow: Clip) -> None:
    with pytest.raises(InvalidInputError, match="seconds must be"):
        toy.inbetween(walk, bow, 99.0, WALK, **HELD)
    other = np.zeros((24, 3), dtype=np.float32)
    with pytest.raises(InvalidInputError, match=r"\(frames, 22, 3\)"):
        toy.inbetween(other, other, 2.0, WALK, **HELD)
    with pytest.raises(InvalidInputError, match="clip"):
        toy.generate(WALK, seconds=2, constraints=[Keyframe(2.5, walk.joints[0])], **HELD)


def test_steps_are_reported_and_can_be_stopped(toy: MotionPipeline, walk: Clip) -> None:
    seen: list[StepInfo] = []
    toy.edit(walk, WAVE, keep="legs", steps=3, on_step=seen.append, **HELD)  # type: ignore[arg-type]
    assert [(info.level, info.done, info.total) for info in seen] == [(FRAMES, step, 3) for step in (1, 2, 3)]
    with pytest.raises(Cancelled):
        toy.edit(walk, WAVE, keep="legs", on_step=lambda info: False, **HELD)


def test_commands_hold_frames(toy: MotionPipeline, toy_bundle: Folder, walk: Clip, here: Folder) -> None:
    walk.save("walk.npz")
    last = ("--space", "frames", "--seed", "3", "--bundle", str(toy_bundle), "--quiet", "-o", "made.npz", "--force")
    assert main(["edit", "walk.npz", WAVE, "--keep", "legs", *last]) == 0
    np.testing.assert_array_equal(read("made.npz").joints, toy.edit(walk, WAVE, keep="legs", **HELD).joints)
    assert main(["inbetween", "walk.npz", "walk.npz", WALK, "--seconds", "2", *last]) == 0
    np.testing.assert_array_equal(read("made.npz").joints, toy.inbetween(walk, walk, 2.0, WALK, **HELD).joints)

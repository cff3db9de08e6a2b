"""Skeleton space on the toy bundle: the same calls and equations as latent space, on the motion features themselves."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("spacy")

from kinegraph import MotionPipeline, frame_timeline
from kinegraph.bundle.contract import FRAMES
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.sampling import StepInfo, ddim_coefficients
from kinegraph.energy import energy_maps
from kinegraph.errors import Cancelled, InvalidInputError
from kinegraph.frame_denoising import FrameSampler, clean_of, group, noise_of, ungroup
from kinegraph.intervals import Interval
from kinegraph.motion.features import features_from_joints
from kinegraph.motion.skeleton import JOINT_INDEX
from kinegraph.options import GenerateOptions, resolve_options
from kinegraph.request import IN_ONE_INTERVAL, TURNS_ARE_FREE
from support.motions import walk

WALKS, WAVES, RUNS = "a person walks forward", "a person waves the right hand", "a person runs"
CLIP = {"seconds": 2.2, "seed": 4, "space": FRAMES}


def sampler_of(toy: MotionPipeline) -> FrameSampler:
    sampler = toy.in_space(FRAMES).sampler
    assert isinstance(sampler, FrameSampler)
    return sampler


def options_of(toy: MotionPipeline, frames: int, **changes: Any) -> GenerateOptions:
    return replace(resolve_options(toy.manifest, seed=4, space=FRAMES, **changes), frames=frames)


def test_clips_have_their_length_and_are_the_same_again(toy: MotionPipeline) -> None:
    clip = toy.generate(WALKS, **CLIP)
    assert clip.joints.shape == (44, 22, 3)
    np.testing.assert_array_equal(toy.generate(WALKS, **CLIP).joints, clip.joints)
    other = toy.generate(WALKS, seconds=2.2, seed=4)
    assert np.abs(other.joints - clip.joints).max() > 0.01, "that is latent space"
    assert len(toy.generate(WALKS, seconds=2.1, seed=4, space=FRAMES).joints) == 42  # no whole groups of four


def test_the_network_does_what_it_is_told(toy: MotionPipeline) -> None:
    """The toy was trained for minutes: it walks where it should walk, and raises a hand where it should wave."""
    walked, waved = (toy.takes(text, 3, seconds=2.4, seed=0, space=FRAMES) for text in (WALKS, WAVES))

    def travel(clip: Any) -> float:
        return float(np.linalg.norm((clip.joints[-1] - clip.joints[0])[0, [0, 2]]))

    def hand(clip: Any) -> float:
        return float((clip.joints[:, 21, 1] - clip.joints[:, 0, 1]).max())

    assert min(map(travel, walked)) > 2 * max(map(travel, waved))
    assert min(map(hand, waved)) > max(map(hand, walked)) + 0.1


def test_a_batch_is_its_members_whatever_their_lengths(toy: MotionPipeline) -> None:
    texts, seconds = [WALKS, WAVES, RUNS], [2.0, 2.4, 1.6]
    together = toy.batch(texts, seconds=seconds, seed=7, space=FRAMES, shared_run=True)
    apart = toy.batch(texts, seconds=seconds, seed=7, space=FRAMES)
    for index, (shared, alone) in enumerate(zip(together, apart, strict=True)):
        single = toy.generate(texts[index], seconds=seconds[index], seed=7 + index, space=FRAMES)
        np.testing.assert_array_equal(alone.joints, single.joints)
        np.testing.assert_allclose(shared.joints, single.joints, atol=1e-4)


@pytest.mark.parametrize("method", ["latent", "semantic", "fused"])
def test_one_concept_is_plain_guidance(toy: MotionPipeline, method: str) -> None:
    plain = toy.generate(WALKS, **CLIP)
    composed = toy.compose([WALKS], method=method, **CLIP)
    np.testing.assert_allclose(composed.joints, plain.joints, atol=1e-4)
    assert np.abs(toy.compose([WALKS, WAVES], method=method, **CLIP).joints - plain.joints).max() > 0.01


def test_adaptive_gradient_descent_of_no_size_is_none(toy: MotionPipeline) -> None:
    still = toy.compose([WALKS, WAVES], agd=(0.0, 0.0), **CLIP)
    moved = toy.compose([WALKS, WAVES], agd=(1e-9, 1e-9), **CLIP)
    np.testing.assert_allclose(moved.joints, still.joints, atol=1e-4)
    assert np.abs(toy.compose([WALKS, WAVES], agd=(0.5, 0.1), **CLIP).joints - still.joints).max() > 1e-4


def test_noise_of_several_concepts_is_equations_seven_and_eight(toy: MotionPipeline) -> None:
    sampler = sampler_of(toy)
    options = options_of(toy, 44, guidance=1.7)
    ddim = ddim_coefficients(sampler.schedule, 5)
    weights, negated = (1.0, 0.6), -0.4
    texts = [WALKS, WAVES, RUNS]
    conditions = toy.encoder.attend(toy.encoder.encode_text([toy.parse(text) for text in texts]))
    mix = CompositionWeights(weights, (), (negated,), (1.0, 0.0, 0.0))
    composed = sampler.predictor(conditions, mix, [options], FRAMES, ddim, None)
    noisy = np.random.default_rng(0).standard_normal((1, 11, sampler.part.level.latent_width)).astype(np.float32)

    def alone(row: int, scale: float) -> np.ndarray:
        own = conditions.map(lambda part: part[row : row + 1])
        guided = replace(options, guidance={FRAMES: scale})
        return sampler.predictor(own, None, [guided], FRAMES, ddim, None)(noisy, 2)

    nothing = alone(0, 0.0)
    expected = nothing + 1.7 * sum(w * (alone(row, 1.0) - nothing) for row, w in enumerate((*weights, negated)))
    np.testing.assert_allclose(composed(noisy, 2), expected, atol=1e-4)


def test_clean_frames_and_noise_are_two_ways_to_say_the_same() -> None:
    rng = np.random.default_rng(1)
    clean, noise = (rng.standard_normal((1, 3, 8)).astype(np.float32) for _ in range(2))
    noisy = np.sqrt(0.3) * clean + np.sqrt(0.7) * noise
    np.testing.assert_allclose(noise_of(noisy, clean, 0.3), noise, atol=1e-6)
    np.testing.assert_allclose(clean_of(noisy, noise, 0.3), clean, atol=1e-6)


def test_groups_of_frames_hold_the_features_of_a_motion(toy: MotionPipeline) -> None:
    features = features_from_joints(walk(40))[None]
    grouped = group(features, toy.manifest)
    part = sampler_of(toy).part
    assert grouped.shape == (1, 10, part.level.latent_width)
    np.testing.assert_allclose(ungroup(grouped, toy.manifest), features, atol=1e-5)
    mean, std = np.array(toy.manifest.features.mean), np.array(toy.manifest.features.std)
    np.testing.assert_allclose(grouped[0, 0, :137], part.scale * (features[0, 0] - mean) / std, atol=1e-5)


def by_hand(toy: MotionPipeline, texts: Sequence[str], lengths: Sequence[int], shared: int) -> np.ndarray:
    """Eq. 11 written out for two texts: guidance, composition and DDIM of every step, one prediction at a time."""
    sampler, steps = sampler_of(toy), 5
    options = options_of(toy, 0)
    scale, alphas = options.guidance[FRAMES], sampler.schedule.alphas_cumprod
    ddim = ddim_coefficients(sampler.schedule, steps)
    conditions = [toy.encoder.attend(toy.encoder.encode_text([toy.parse(text)])) for text in texts]

    def bound(index: int, tokens: int, guidance: float) -> Any:
        own = replace(options, frames=4 * tokens, guidance={FRAMES: guidance})
        return sampler.predictor(conditions[index], None, [own], FRAMES, ddim, None)

    first, second = lengths
    total = first + second - shared
    rng = np.random.Generator(np.random.PCG64(4))
    x = rng.standard_normal((1, total, sampler.part.level.latent_width), dtype=np.float32)
    for step, time in enumerate(ddim.timesteps):
        one, two = x[:, :first], x[:, first - shared :]
        m1 = bound(0, first, 0.0)(one, step) * (1 - scale) + scale * bound(0, first, 1.0)(one, step)
        m2 = bound(1, second, 0.0)(two, step) * (1 - scale) + scale * bound(1, second, 1.0)(two, step)
        m3 = bound(0, shared, 0.0)(x[:, first - shared : first], step)
        middle = m1[:, first - shared :] + m2[:, :shared] - m3
        eps = np.concatenate([m1[:, : first - shared], middle, m2[:, shared:]], axis=1)
        now, after = alphas[time], alphas[time - 200] if time >= 200 else 1.0  # 5 of 1,000 steps, the last one clean
        clean = (x - np.sqrt(1 - now) * eps) / np.sqrt(now)
        x = (np.sqrt(after) * clean + np.sqrt(1 - after) * eps).astype(np.float32)
    return ungroup(x, toy.manifest)[0]


def test_a_timeline_of_two_texts_is_equation_eleven(toy: MotionPipeline) -> None:
    pytest.importorskip("spacy")
    timeline = [Interval(WALKS, 0, 2.0), Interval(WAVES, 2.0, 3.6)]
    clip = toy.timeline(timeline, overlap=0.8, seed=4, space=FRAMES, foot_fix=False)
    # 2 s and 1.6 s are 10 and 8 groups of frames; each gets 2 more
    features = by_hand(toy, [WALKS, WAVES], [12, 10], 4)
    decoder = toy.in_space(FRAMES).decoder
    sampler = sampler_of(toy)
    expected = decoder.joints(group(features[None], sampler.manifest), [72], FRAMES)[0]
    assert clip.joints.shape == (72, 22, 3)
    np.testing.assert_allclose(clip.joints, expected, atol=1e-4)


@pytest.mark.parametrize(
    "text",
    [
        WALKS,
        "a person walks forward, then bows",  # made one by one
        "a person raises the left hand while waving the right hand",  # sampled alone
        "a person walks without waving",
        "a person turns left by 90 degrees",
    ],
)
def test_a_timeline_of_one_interval_is_generating_it(toy: MotionPipeline, text: str) -> None:
    for space in ("latent", FRAMES):
        options: dict[str, Any] = {"seed": 4, "space": space, "steps": 3}
        whole = toy.generate(text, seconds=4.2, **options)
        timeline = toy.timeline([Interval(text, 0, 4.2)], **options)
        np.testing.assert_array_equal(timeline.joints, whole.joints)
        assert (timeline.notes, timeline.unknown, timeline.text) == (whole.notes, whole.unknown, whole.text)


def test_actions_in_order_within_one_of_several_intervals_are_told(toy: MotionPipeline) -> None:
    ordered = Interval("a person walks forward, then bows", 0, 4.2)
    for space in ("latent", FRAMES):
        assert IN_ONE_INTERVAL in toy.timeline([ordered, Interval(WAVES, 4.2, 6)], seed=4, space=space, steps=2).notes
        plain = toy.timeline([Interval(WALKS, 0, 4.2), Interval(WAVES, 4.2, 6)], seed=4, space=space, steps=2)
        assert IN_ONE_INTERVAL not in plain.notes


def test_an_arm_of_its_own_leaves_the_legs_alone_until_it_matters(toy: MotionPipeline) -> None:
    alone = toy.timeline([Interval(WALKS, 0, 3.2)], seed=4, space=FRAMES, foot_fix=False)
    both = [Interval(WALKS, 0, 3.2, ("legs", "torso", "head", "left arm")), Interval(WAVES, 0, 3.2, ("right arm",))]
    waved = toy.timeline(both, seed=4, space=FRAMES, foot_fix=False)
    assert waved.text == f"{WALKS}; {WAVES}"
    hand = [clip.joints[:, 21, 1] - clip.joints[:, 0, 1] for clip in (alone, waved)]
    assert hand[1].max() > hand[0].max() + 0.1
    travelled = [float(np.linalg.norm((clip.joints[-1] - clip.joints[0])[0, [0, 2]])) for clip in (alone, waved)]
    assert travelled[1] > 0.5 * travelled[0]


def test_features_of_a_part_are_those_that_its_joints_change(toy: MotionPipeline) -> None:
    joints = walk(40)
    before = features_from_joints(joints)

    def of(*parts: str) -> np.ndarray:
        mask = frame_timeline.features_of_parts(parts, toy.manifest).reshape(-1, before.shape[1])
        assert (mask == mask[0]).all()
        return mask[0] > 0

    for part, names in (("left arm", ("left_elbow", "left_wrist")), ("head", ("head",))):
        moved = joints.copy()
        for name in names:
            moved[:, JOINT_INDEX[name], 1] += 0.1 * np.sin(np.arange(40) / 5)
        changed = (np.abs(features_from_joints(moved) - before) > 1e-5).any(axis=0)
        others = {"left arm", "right arm", "head", "torso", "legs"} - {part, *(["torso"] if part == "head" else [])}
        assert changed.any() and of(part)[changed].all() and not (of(*others) & changed).any()
    assert of("legs", "arms", "head", "torso").all() and of().all()


def test_in_latent_space_what_coincides_is_composed(toy: MotionPipeline) -> None:
    composed = toy.compose([WALKS, WAVES], method="fused", seconds=2.2, seed=4)
    timeline = toy.timeline([Interval(WALKS, 0, 2.2), Interval(WAVES, 0, 2.2)], seed=4)
    np.testing.assert_array_equal(timeline.joints, composed.joints)
    negating = ["a person walks without waving", "a person nods"]  # what one negates must not happen in the other
    composed = toy.compose(negating, seconds=2.2, seed=4)
    timeline = toy.timeline([Interval(text, 0, 2.2) for text in negating], seed=4)
    np.testing.assert_array_equal(timeline.joints, composed.joints)
    sequence = toy.timeline([Interval(WALKS, 0, 2), Interval(WAVES, 2, 4)], seed=4)
    np.testing.assert_array_equal(sequence.joints, toy.sequence([WALKS, WAVES], seconds=2, seed=4).joints)


@pytest.mark.parametrize(
    ("timeline", "options", "message"),
    [
        ([Interval(WALKS, 0, 3), Interval(WAVES, 1, 2)], {}, 'take space="frames"'),
        ([Interval(WALKS, 0, 3, ("legs",))], {}, 'take space="frames"'),
        ([Interval(WALKS, 0, 3)], {"overlap": 1.0}, "overlap is for"),
        ([Interval(WALKS, 0, 3)], {"overlap": -1.0, "space": FRAMES}, "overlap must be 0 to 4"),
        ([Interval(WALKS, 0, 0.3)], {"space": FRAMES}, "seconds must be 0.8 to 9.8"),
        ([Interval(WALKS, 0, 9.8), Interval(WAVES, 9.8, 12)], {"space": FRAMES}, "with its overlaps"),
        ([Interval(WALKS, 0, 3)], {"space": "time"}, "space must be one of latent, frames"),
        ([WALKS], {}, "list of Interval"),
    ],
)
def test_what_a_timeline_cannot_be(toy: MotionPipeline, timeline: Any, options: Any, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        toy.timeline(timeline, seed=1, **options)


def test_steps_are_reported_and_can_be_stopped(toy: MotionPipeline) -> None:
    seen: list[StepInfo] = []
    toy.takes(WALKS, 2, steps=3, on_step=seen.append, **CLIP)  # type: ignore[arg-type]
    assert [(info.level, info.step, info.done, info.total) for info in seen] == [
        (FRAMES, index % 3 + 1, index + 1, 6) for index in range(6)
    ]
    with pytest.raises(Cancelled):
        toy.timeline([Interval(WALKS, 0, 2)], space=FRAMES, on_step=lambda info: False)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"space": "pixels"}, "space must be one of latent, frames, not 'pixels'"),
        ({"space": None}, "space must be one of"),
        ({"steps": (3, 3, 3)}, "steps must be one number or 1"),
        ({"steps": {"motion": 3}}, "unknown level 'motion'"),
    ],
)
def test_what_skeleton_space_does_not_take(toy: MotionPipeline, options: Any, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        toy.generate(WALKS, **{**CLIP, **options})


def test_a_bundle_without_skeleton_space_says_how_to_add_it(toy: MotionPipeline) -> None:
    bare = MotionPipeline(
        dataclasses.replace(
            toy.manifest,
            frames_part=None,
            files={name: entry for name, entry in toy.manifest.files.items() if not name.startswith(FRAMES)},
            operators={name: each for name, each in toy.manifest.operators.items() if not name.startswith(FRAMES)},
        ),
        toy.sampler.sessions,
        toy.encoder.tokenizer,
        toy.encoder.tables,
        toy.parser,
    )

    def edit(text: str, **options: Any) -> Any:
        return bare.edit(toy.generate(WALKS, seconds=2, seed=1), text, keep="legs", space=options["space"])

    for call in (bare.generate, lambda text, **options: bare.compose([text], **options), edit):
        with pytest.raises(InvalidInputError, match=r"no skeleton space; .* python -m kinegraph_export.add_frames"):
            call(WALKS, **CLIP)


def test_a_turn_of_one_interval_is_not_that_of_all(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def make(*args: Any) -> Any:
        asked.append(next(arg for arg in args if isinstance(arg, GenerateOptions)).turn)
        return make_timeline(*args)

    make_timeline = frame_timeline.make_timeline
    monkeypatch.setattr(frame_timeline, "make_timeline", make)
    left = "a person turns left by 90 degrees"
    toy.timeline([Interval(left, 0.0, 2.0, ("legs", "arms", "head", "torso"))], seed=4, space=FRAMES)
    toy.sequence([left, left], method="energy", seconds=2.0, seed=4)
    assert asked[0] is not None and asked[0].degrees == 90 and asked[1] is None
    assert TURNS_ARE_FREE in toy.sequence([left, WALKS], method="energy", seconds=2.0, seed=4, steps=2).notes
    assert TURNS_ARE_FREE not in toy.sequence([WALKS, WALKS], method="energy", seconds=2.0, seed=4, steps=2).notes


def test_what_one_run_has_no_use_for_is_refused(toy: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match="seed_offsets is for parts that are made one by one"):
        toy.sequence([WALKS, WAVES], method="energy", seed_offsets=[0, 5])
    with pytest.raises(InvalidInputError, match="energy maps are of latent space"):
        energy_maps(toy.in_space(FRAMES), [WALKS, WAVES])


def test_a_sequence_by_energy_is_a_timeline_of_its_parts(toy: MotionPipeline) -> None:
    texts = [WALKS, WAVES, RUNS]
    clip = toy.sequence(texts, method="energy", seconds=[2.0, 1.6, 2.4], seed=4)
    times = [(0.0, 2.0), (2.0, 3.6), (3.6, 6.0)]
    timeline = [Interval(text, *time) for text, time in zip(texts, times, strict=True)]
    np.testing.assert_array_equal(clip.joints, toy.timeline(timeline, seed=4, space=FRAMES).joints)
    assert (
        clip.frames == 120
        and clip.text == "a person walks forward, then a person waves the right hand, then a person runs"
    )
    alone = toy.sequence([WALKS], method="energy", seconds=2.0, seed=4)
    np.testing.assert_array_equal(alone.joints, toy.generate(WALKS, seconds=2.0, seed=4, space=FRAMES).joints)
    jumps = np.linalg.norm(np.diff(clip.joints, axis=0), axis=-1).max(axis=1)
    assert jumps[36:44].max() < 3 * np.percentile(jumps, 95), "a jump where two parts meet"


def test_a_run_starts_at_the_last_timestep_and_ends_at_the_clean_frames(toy: MotionPipeline) -> None:
    schedule = replace(sampler_of(toy).part, beta_end=0.0225).schedule(toy.manifest.schedule.noise)
    betas = np.linspace(np.sqrt(0.00085), np.sqrt(0.0225), 1000) ** 2
    np.testing.assert_allclose(schedule.alphas_cumprod, np.cumprod(1 - betas), rtol=1e-10)
    assert schedule.alphas_cumprod[-1] < 1.1e-4 < toy.manifest.schedule.noise.alphas_cumprod[-1] / 20
    ddim = ddim_coefficients(schedule, 20)
    assert ddim.timesteps[0] == 999 and ddim.timesteps[-1] == 49
    # a perfect prediction of the noise gives the clean frames back
    clean, noise = np.random.default_rng(0).standard_normal((2, 3))
    alpha = schedule.alphas_cumprod[49]
    noisy = np.sqrt(alpha) * clean + np.sqrt(1 - alpha) * noise
    np.testing.assert_allclose(ddim.keep[-1] * noisy + ddim.move[-1] * noise, clean, atol=1e-12)

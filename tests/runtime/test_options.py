"""Options: the bundle's defaults filled in, and every invalid option refused with the allowed values."""

from __future__ import annotations

import dataclasses
import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.manifest import Manifest, ScheduleSpec
from kinegraph.errors import InvalidInputError
from kinegraph.options import GenerateOptions, frame_count, parse_numbers, resolve_options
from support.synthetic_bundle import bundle_files, manifest_for

TOY = manifest_for(bundle_files())
EDGE = dataclasses.replace(
    TOY,
    frames=dataclasses.replace(TOY.frames, min=16, max=196),
    schedule=ScheduleSpec(1000, 8.5e-4, 0.012, 1, "leading", "epsilon"),
)
"""The limits of the default bundle: 0.8 to 9.8 seconds, 1000 training steps."""


def test_defaults_are_the_bundles() -> None:
    options = resolve_options(TOY, seed=3)
    assert options == GenerateOptions(
        frames=20,
        seconds=1.0,
        seed=3,
        steps={"motion": 3, "action": 4, "specific": 5},
        guidance={"motion": 2.5, "action": 2.5, "specific": 2.5},
    )


def test_nothing_can_be_changed() -> None:
    options = resolve_options(TOY, steps=4)
    with pytest.raises(dataclasses.FrozenInstanceError):
        options.seed = 3  # type: ignore[misc]
    with pytest.raises(TypeError):
        options.steps["motion"] = 1  # type: ignore[index]


@pytest.mark.parametrize(
    ("seconds", "frames"),
    [
        (0.8, 16),
        (9.8, 196),
        (4, 80),
        (1.26, 25),
        (np.float32(2.0), 40),
        (np.int64(2), 40),
        (Fraction(5, 2), 50),
    ],
)
def test_seconds_become_frames(seconds: float, frames: int) -> None:
    options = resolve_options(EDGE, seconds=seconds)
    assert (options.frames, options.seconds) == (frames, frames / 20)


BAD_SECONDS = [
    0,
    -4,
    -0.0,
    0.7,
    9.9,
    1e9,
    10**9,
    10**400,
    Fraction(10**5000, 3),
    math.nan,
    math.inf,
    -math.inf,
    True,
    np.True_,
    "4",
    b"4",
    [4],
    4j,
    Decimal(4),
    np.array([4.0]),
]


@pytest.mark.parametrize(
    "seconds",
    BAD_SECONDS,
    ids=lambda value: type(value).__name__ + repr(value)[:20] if not isinstance(value, Fraction) else "fraction",
)
def test_bad_seconds_name_the_limits(seconds: object) -> None:
    with pytest.raises(InvalidInputError, match=r"seconds must be 0\.8 to 9\.8 seconds") as caught:
        frame_count(EDGE, seconds)  # type: ignore[arg-type]
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("seed", [0, 1, 2**63 - 1, np.int64(7), np.uint8(200)])
def test_seeds_are_kept(seed: int) -> None:
    options = resolve_options(TOY, seed=seed)
    assert options.seed == seed
    assert type(options.seed) is int


@pytest.mark.parametrize(
    "seed",
    [-1, 2**63, 10**5000, True, 1.0, math.nan, "7", [7], np.float64(7)],
    ids=lambda v: str(v)[:9] if not isinstance(v, int) else f"{v.bit_length()} bits",
)
def test_bad_seeds_are_refused(seed: object) -> None:
    with pytest.raises(InvalidInputError, match=r"seed must be a whole number from 0 to 2\*\*63 - 1") as caught:
        resolve_options(TOY, seed=seed)  # type: ignore[arg-type]
    assert len(str(caught.value)) < 200


def test_without_a_seed_every_call_draws_one_and_leaves_global_state_alone() -> None:
    before = np.random.get_state()[1].copy()  # noqa: NPY002 - the legacy state is what must not move
    seeds = {resolve_options(TOY).seed for _ in range(50)}
    assert len(seeds) > 45
    assert all(0 <= seed < 2**32 for seed in seeds)
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        (7, (7, 7, 7)),
        ((1, 2, 3), (1, 2, 3)),
        ([1, 2, 3], (1, 2, 3)),
        ({"action": 9}, (3, 9, 5)),
        ({}, (3, 4, 5)),
        (np.int32(2), (2, 2, 2)),
    ],
)
def test_steps_for_all_or_per_level(steps: object, expected: tuple[int, ...]) -> None:
    resolved = resolve_options(EDGE, steps=steps).steps  # type: ignore[arg-type]
    assert tuple(resolved[level] for level in LEVELS) == expected
    assert tuple(resolved) == LEVELS


@pytest.mark.parametrize(
    "steps",
    [
        0,
        -1,
        1001,
        10**6,
        10**5000,
        True,
        2.0,
        "15",
        (1, 2),
        (1, 2, 3, 4),
        (1, 2, 0),
        (1, 2, None),
        {"motion": 0},
        {"body": 3},
        {1: 3},
        {4.5},
    ],
    ids=lambda value: str(value)[:12] if not isinstance(value, int) else f"{value.bit_length()} bits",
)
def test_bad_steps_are_refused(steps: object) -> None:
    with pytest.raises(InvalidInputError, match=r"^steps") as caught:
        resolve_options(EDGE, steps=steps)  # type: ignore[arg-type]
    assert len(str(caught.value)) < 200


def test_steps_beyond_the_table_are_refused() -> None:
    """With an offset of 1, 1000 leading steps would ask for the timestep 1000 of a table of 0 to 999."""
    assert resolve_options(EDGE, steps=999).steps["motion"] == 999
    with pytest.raises(InvalidInputError, match=r"steps of level motion: .*timestep 1000"):
        resolve_options(EDGE, steps=1000)
    trailing = dataclasses.replace(EDGE, schedule=dataclasses.replace(EDGE.schedule, spacing="trailing"))
    assert resolve_options(trailing, steps=1000).steps["motion"] == 1000


@pytest.mark.parametrize(
    ("guidance", "expected"),
    [(0, (0, 0, 0)), (20, (20, 20, 20)), ((1, 2.5, 3), (1, 2.5, 3)), ({"motion": 1}, (1, 2.5, 2.5))],
)
def test_guidance_for_all_or_per_level(guidance: object, expected: tuple[float, ...]) -> None:
    resolved = resolve_options(EDGE, guidance=guidance).guidance  # type: ignore[arg-type]
    assert tuple(resolved[level] for level in LEVELS) == expected
    assert all(type(value) is float for value in resolved.values())


@pytest.mark.parametrize(
    "guidance",
    [
        -0.1,
        20.1,
        math.nan,
        math.inf,
        True,
        "2",
        None.__class__,
        (1, 2),
        {"all": 2},
        (1, math.nan, 2),
        10**400,
    ],
    ids=lambda value: str(value)[:12] if not isinstance(value, int) else f"{value.bit_length()} bits",
)
def test_bad_guidance_is_refused(guidance: object) -> None:
    with pytest.raises(InvalidInputError, match=r"^guidance"):
        resolve_options(EDGE, guidance=guidance)  # type: ignore[arg-type]


SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.sampled_from([10**400, -(10**400), 10**5000])
    | st.floats()
    | st.text(max_size=5)
    | st.binary(max_size=3)
    | st.fractions()
    | st.decimals()
    | st.complex_numbers()
)
ANYTHING = SCALARS | st.lists(SCALARS, max_size=4) | st.tuples(SCALARS, SCALARS, SCALARS)
ANYTHING |= st.dictionaries(st.sampled_from(LEVELS) | st.integers() | st.text(), SCALARS, max_size=3)


@settings(max_examples=500, deadline=None)
@given(seconds=ANYTHING, seed=ANYTHING, steps=ANYTHING, guidance=ANYTHING)
def test_any_options_give_valid_options_or_a_typed_error(
    seconds: object, seed: object, steps: object, guidance: object
) -> None:
    for given_options in (
        {"seconds": seconds, "seed": seed, "steps": steps, "guidance": guidance},
        {"seconds": seconds},
        {"seed": seed},
        {"steps": steps},
        {"guidance": guidance},
    ):
        try:
            options = resolve_options(EDGE, **given_options)  # type: ignore[arg-type]
        except InvalidInputError:
            continue
        check_valid(options, EDGE)


def check_valid(options: GenerateOptions, manifest: Manifest) -> None:
    assert type(options.frames) is int
    assert manifest.frames.min <= options.frames <= manifest.frames.max
    assert options.seconds == options.frames / manifest.fps
    assert type(options.seed) is int
    assert 0 <= options.seed < 2**63
    for level in LEVELS:
        assert type(options.steps[level]) is int
        times = manifest.schedule.noise.timesteps(options.steps[level])
        assert len(times) == options.steps[level]
        assert 0 <= options.guidance[level] <= 20


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        ("15", int, 15),
        ("15,15,20", int, (15, 15, 20)),
        ("2.5", float, 2.5),
        ("2.5, 2.5,3", float, (2.5, 2.5, 3.0)),
        ("nan", float, pytest.approx(math.nan, nan_ok=True)),
    ],
)
def test_numbers_are_parsed_from_text(text: str, kind: type[int] | type[float], expected: object) -> None:
    assert parse_numbers(text, kind) == expected


@pytest.mark.parametrize(
    ("text", "kind"), [("", int), ("1,", int), ("1.5", int), ("many", float), ("1;2", float), ("9" * 5000, int)]
)
def test_text_without_numbers_is_refused(text: str, kind: type[int] | type[float]) -> None:
    with pytest.raises(InvalidInputError, match="is not a number, nor several like 15,15,20") as caught:
        parse_numbers(text, kind)
    assert len(str(caught.value)) < 200

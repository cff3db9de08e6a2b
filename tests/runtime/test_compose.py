"""Composition: the identities that users may rely on, and bad input before any model runs."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import Concept, InvalidInputError, MotionPipeline
from kinegraph.cli.inputs import split_weight
from kinegraph.concepts import joint_caption, validate_concepts, validate_lambdas
from kinegraph.conditioning import ConditionEncoder
from kinegraph.diffusion.sampling import StepInfo
from support.cli_runs import fails

pytest.importorskip("spacy")

FEW: dict[str, Any] = {"steps": (3, 3, 4), "seconds": 2, "seed": 5}
WALK, WAVE = "a person walks forward", "a person waves the right hand"
EVERY = [
    {"method": "latent"}, {"method": "semantic"}, {"method": "fused"},
    {"method": "fused", "lambdas": (0.5, 0.2, 0.3)}, {"method": "fused", "lambdas": (0.0, 0.0, 1.0)},
]  # fmt: skip


@pytest.mark.parametrize("how", EVERY, ids=str)
def test_one_concept_of_weight_one_is_generate(toy: MotionPipeline, how: dict[str, Any]) -> None:
    plain = toy.generate(WALK, **FEW)
    np.testing.assert_allclose(toy.compose([Concept(WALK)], **how, **FEW).joints, plain.joints, atol=1e-4)


@pytest.mark.parametrize("method", ["latent", "semantic", "fused"])
def test_the_order_of_concepts_does_not_matter(toy: MotionPipeline, method: str) -> None:
    how = {"method": method, **({"text": f"{WALK} and waves"} if method == "fused" else {})}
    concepts = [Concept(WALK), Concept(WAVE, 0.7), Concept("a person runs", -0.4)]
    forward, backward = (toy.compose(order, **how, **FEW).joints for order in (concepts, concepts[::-1]))
    np.testing.assert_allclose(forward, backward, atol=1e-4)


@pytest.mark.parametrize("method", ["latent", "semantic", "fused"])
def test_a_concept_twice_at_half_weight_counts_once(toy: MotionPipeline, method: str) -> None:
    how = {"method": method, **({"text": f"{WALK} and waves"} if method == "fused" else {})}
    whole = toy.compose([Concept(WALK), Concept(WAVE)], **how, **FEW).joints
    halves = toy.compose([Concept(WALK, 0.5), Concept(WAVE), Concept(WALK, 0.5)], **how, **FEW).joints
    np.testing.assert_allclose(whole, halves, atol=1e-4)


@pytest.mark.parametrize(
    ("lambdas", "same"), [((1.0, 0.0, 0.0), {"method": "latent"}), ((0.0, 1.0, 0.0), {"method": "semantic"})]
)
def test_fusion_with_one_share_is_that_term(
    toy: MotionPipeline, lambdas: tuple[float, float, float], same: dict[str, str]
) -> None:
    concepts = [Concept(WALK), Concept(WAVE)]
    fused = toy.compose(concepts, lambdas=lambdas, **FEW).joints
    np.testing.assert_allclose(fused, toy.compose(concepts, **same, **FEW).joints, atol=1e-4)
    text = toy.compose(concepts, lambdas=(0.0, 0.0, 1.0), text="someone bows", **FEW).joints
    np.testing.assert_allclose(text, toy.generate("someone bows", **FEW).joints, atol=1e-4)


def test_methods_differ_and_weights_matter(toy: MotionPipeline) -> None:
    concepts = [Concept(WALK), Concept(WAVE)]
    latent, semantic = (toy.compose(concepts, method=method, **FEW).joints for method in ("latent", "semantic"))
    assert not np.allclose(latent, semantic, atol=1e-3)
    lighter = toy.compose([Concept(WALK), Concept(WAVE, 0.2)], method="latent", **FEW).joints
    assert not np.allclose(latent, lighter, atol=1e-3)


@pytest.mark.parametrize("lambdas", [(0.1, 0.3, 0.6), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_a_negation_beside_one_concept_is_the_same_for_all_lambdas(
    toy: MotionPipeline, lambdas: tuple[float, float, float]
) -> None:
    # One concept of weight 1 is plain guidance whatever the lambdas, and Eq. 8 stands beside them.
    concepts = [Concept(WALK), Concept("a person runs", -1.0)]
    latent = toy.compose(concepts, method="latent", **FEW).joints
    np.testing.assert_allclose(toy.compose(concepts, lambdas=lambdas, **FEW).joints, latent, atol=1e-4)
    assert not np.allclose(latent, toy.generate(WALK, **FEW).joints, atol=1e-2)


def test_fusion_with_all_in_the_latent_share_is_latent_with_negations_too(toy: MotionPipeline) -> None:
    concepts = [Concept(WALK), Concept(WAVE, 0.7), Concept("a person runs", -0.6)]
    fused = toy.compose(concepts, lambdas=(1.0, 0.0, 0.0), **FEW).joints
    np.testing.assert_allclose(fused, toy.compose(concepts, method="latent", **FEW).joints, atol=1e-4)


def test_no_step_size_is_without_adaptive_gradient_descent(toy: MotionPipeline) -> None:
    plain = toy.compose([WALK, WAVE], method="fused", **FEW).joints
    np.testing.assert_array_equal(toy.compose([WALK, WAVE], agd=(0.0, 0.0), **FEW).joints, plain)


def test_a_bundle_without_its_graphs_says_so(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    toy = toy.with_sessions(dataclasses.replace(toy.sampler.sessions, context_agd={}, denoiser_agd={}))
    monkeypatch.setattr(ConditionEncoder, "encode_text", None)
    with pytest.raises(InvalidInputError, match=r"no graphs for adaptive gradient descent: leave agd out"):
        toy.compose([WALK, WAVE], agd=(4e-4, 4e-4), **FEW)


def test_adaptive_gradient_descent_moves_the_motion_by_its_step_size(toy: MotionPipeline) -> None:
    nothing, small, large = (toy.compose([WALK, WAVE], agd=(size, size), **FEW).joints for size in (1e-9, 4e-4, 0.1))
    near, far = (float(np.abs(moved - nothing).max()) for moved in (small, large))
    assert 0 < near < far


def test_adaptive_gradient_descent_knows_no_order(toy: MotionPipeline) -> None:
    how: dict[str, Any] = {"agd": (1e-3, 2e-3), "text": f"{WALK} and waves", **FEW}
    concepts = [Concept(WALK), Concept(WAVE, 0.7), Concept("a person runs", -1.0)]
    forward, backward = (toy.compose(order, **how).joints for order in (concepts, concepts[::-1]))
    np.testing.assert_allclose(forward, backward, atol=1e-4)


class Counted:
    """A session that tells when it runs."""

    def __init__(self, session: Any, runs: list[Any]) -> None:
        self.session, self.runs = session, runs

    def run(self, *arguments: Any) -> Any:
        self.runs.append(self.session)
        return self.session.run(*arguments)

    def get_inputs(self) -> Any:
        return self.session.get_inputs()


def test_one_run_per_step(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[Any] = []
    counted = {level: Counted(session, runs) for level, session in toy.sampler.sessions.denoiser.items()}
    toy = toy.with_sessions(dataclasses.replace(toy.sampler.sessions, denoiser=counted))
    seen: list[StepInfo] = []
    concepts = [WALK, WAVE, Concept("a person runs", -0.5)]
    toy.compose(concepts, on_step=lambda info: bool(seen.append(info)) or True, **FEW)
    assert len(runs) == len(seen) == 10


def test_edited_graphs_are_concepts_too(toy: MotionPipeline) -> None:
    graph = toy.parse(WALK)
    composed = toy.compose([Concept(graph), WAVE], method="latent", **FEW)
    np.testing.assert_array_equal(composed.joints, toy.compose([WALK, WAVE], method="latent", **FEW).joints)
    assert composed.text == f"{WALK} while {WAVE}"


BAD: list[tuple[Any, dict[str, Any], str]] = [
    ([], {}, "1 to 8 concepts, not 0"),
    ([WALK] * 9, {}, "1 to 8 concepts, not 9"),
    (WALK, {}, "list of Concept"),
    ([Concept(WALK, -1)], {}, "negated"),
    ([WALK], {"method": "sum"}, "'sum'"),
    ([WALK], {"lambdas": (0.5, 0.5, 0.5)}, "sums to 1.5"),
    ([WALK], {"lambdas": (1.5, -0.5, 0.0)}, "from 0 to 1"),
    ([WALK], {"lambdas": (float("nan"), 0.5, 0.5)}, "from 0 to 1"),
    ([WALK], {"lambdas": (1.0,)}, "three numbers"),
    ([WALK], {"lambdas": "abc"}, "three numbers"),
    ([WALK], {"method": "latent", "lambdas": (1.0, 0.0, 0.0)}, "lambdas is for"),
    ([WALK], {"method": "latent", "text": "a person walks"}, "text is for"),
    ([WALK, Concept(WAVE, -1)], {"method": "semantic"}, "sum to 0"),
    ([Concept(WALK, 0.04)], {}, "sum to 0.04"),
    ([WALK, WAVE], {"agd": 0.001}, "two step sizes"),
    ([WALK, WAVE], {"agd": (0.001,)}, "two step sizes"),
    ([WALK, WAVE], {"agd": (-0.001, 0.0)}, "two step sizes"),
    ([WALK, WAVE], {"agd": (float("nan"), 0.0)}, "two step sizes"),
    ([WALK, WAVE], {"agd": (2.0, 0.0)}, "two step sizes"),
    ([WALK, WAVE], {"agd": ("a", 0.0)}, "two step sizes"),
    ([WALK, WAVE], {"guidance": float("nan")}, "guidance"),
    ([WALK, Concept(WAVE, -0.7)], {"method": "semantic"}, "make the negations weaker"),
    ([WALK], {"seconds": float("inf")}, "seconds"),
    ([WALK], {"text": " "}, "caption"),
]


@pytest.mark.parametrize(("concepts", "options", "message"), BAD)
def test_bad_input_is_refused_before_a_model_runs(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch, concepts: Any, options: dict[str, Any], message: str
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("a model ran")

    monkeypatch.setattr(ConditionEncoder, "encode_text", never)
    with pytest.raises(InvalidInputError, match=message):
        toy.compose(concepts, **options)


@pytest.mark.parametrize("weight", [0, float("nan"), float("inf"), 11, -11, "1", None, True])
def test_a_weight_that_is_none_is_refused(weight: Any) -> None:
    with pytest.raises(InvalidInputError, match="weight"):
        Concept(WALK, weight)


@pytest.mark.parametrize("text", ["", "…", None, 5])
def test_a_concept_without_words_is_refused(text: Any) -> None:
    with pytest.raises(InvalidInputError, match="caption"):
        Concept(text)


def test_latent_negation_needs_no_positive_sum() -> None:
    concepts = validate_concepts([WALK, Concept(WAVE, -1)])
    assert validate_lambdas("latent", None, None, concepts) == (1.0, 0.0, 0.0)


def test_the_joint_sentence_names_what_should_happen() -> None:
    concepts = validate_concepts(
        ["A person walks.", Concept("a person runs", -0.5), "a person waves", "A person walks"]
    )
    assert joint_caption(concepts) == "A person walks while a person waves"
    assert joint_caption(concepts[:2]) == "A person walks."


@pytest.mark.parametrize(
    ("text", "expected"),
    [("walks", ("walks", None)), ("walks:0.8", ("walks", 0.8)), ("a: b", ("a: b", None)), ("a:b:2", ("a:b", 2.0))],
)
def test_a_number_after_a_colon_is_a_weight(text: str, expected: tuple[str, float | None]) -> None:
    assert split_weight(text) == expected


@pytest.mark.parametrize("text", ["a person walks:2x", "a person runs:fast", "walks:1:"])
def test_what_stands_behind_a_colon_must_be_a_weight(text: str) -> None:
    if text.endswith(":"):  # a sentence may end so
        assert split_weight(text) == (text, None)
        return
    with pytest.raises(InvalidInputError, match=r"is no weight; write one as in 'a person walks:0\.8'"):
        split_weight(text)


@pytest.mark.parametrize("text", ["a person walks=0.3", "a person walks = 0.3", "a person walks*0.3"])
def test_a_weight_behind_another_sign_is_refused(text: str) -> None:
    with pytest.raises(InvalidInputError, match=r"write the weight as a person walks:0\.3"):
        split_weight(text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "x.npz"], "1 to 8 concepts"),
        (["--not", "a person runs", "-o", "x.npz"], "negated"),
        (["--and", "a person walks:nan", "-o", "x.npz"], "nan"),
        (["--and", "a person walks", "--method", "sum", "-o", "x.npz"], "'sum'"),
        (["--and", "a person walks", "-o", "x.mp3"], "mp3"),
        (["--and", "a person walks", "--agd", "5", "-o", "x.npz"], "two step sizes"),
    ],
)
def test_the_command_line_says_what_is_wrong(
    capsys: pytest.CaptureFixture[str], here: Path, arguments: list[str], message: str
) -> None:
    assert message in fails(capsys, "compose", *arguments)
    assert not list(here.iterdir())


@pytest.mark.usefixtures("toy_by_default")
def test_the_command_line_composes(capsys: pytest.CaptureFixture[str], here: Path) -> None:
    from kinegraph import cli

    words = ["--and", WALK, "--and", f"{WAVE}:0.8", "--not", "a person runs", "--steps", "2", "--seconds", "1"]
    assert cli.main(["compose", *words, "--seed", "3", "-o", "x.npz"]) == 0
    assert "x.npz: 20 frames" in capsys.readouterr().out
    with np.load(here / "x.npz") as stored:
        assert str(stored["text"]) == f"{WALK} while {WAVE}"

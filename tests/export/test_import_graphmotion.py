"""GraphMotion's checkpoint as a bundle: the official modules' numbers through onnxruntime, sentences, compositions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph import Concept, MotionPipeline
from kinegraph.bench import GRAPH
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.sessions import run_model
from kinegraph.bundle.verify import verify_bundle
from kinegraph.concat_denoising import ConcatPrediction, ConcatSampler
from kinegraph.conditioning import PADDING_BIAS
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.sampling import ddim_coefficients
from kinegraph.energy import energy_maps
from kinegraph.errors import InvalidInputError
from kinegraph.graph import MOTION_ACTION, ROLES, Action, Argument, SemanticGraph
from kinegraph.motion.humanml3d import joints_from_humanml3d
from kinegraph.options import resolve_options
from kinegraph.slot_conditioning import SlotConditions, slot_kinds
from support.shared import shared_path

pytest.importorskip("torch")
pytest.importorskip("onnx")

Arrays = dict[str, np.ndarray]
STAGES = dict(enumerate(LEVELS, start=1))
pytestmark = pytest.mark.slow
TOLERANCE = 1e-4
WAVES = SemanticGraph("a man waves", (Action("waves", 6, 11, 0, arguments=(Argument("ARG0", "a man", 0, 5),)),))
SHORT = {"seconds": 2, "seed": 3, "steps": 3}


def distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max())


def official(name: str) -> Arrays:
    with np.load(shared_path("fixtures", "official", name), allow_pickle=False) as pack:
        return dict(pack)


def frame_mask(lengths: np.ndarray) -> np.ndarray:
    return (np.arange(lengths.max()) < lengths[:, None]).astype(np.float32)


def test_graph_attention(graphmotion: MotionPipeline) -> None:
    graphs = official("gm_small.graph.npz")
    names = [MOTION_ACTION if name == "MA" else str(name) for name in graphs["edge_types"]]
    order = [names.index(role) for role in ROLES]
    for part in ("eval", "train"):
        inputs = {
            "nodes": graphs[f"{part}.nodes_in"],
            "adjacency": (graphs[f"{part}.adj"] > 0).astype(np.float32),
            "relations": (graphs[f"{part}.typed_adj"][order] > 0).swapaxes(0, 1).astype(np.float32),
        }
        (nodes,) = run_model(graphmotion.encoder.sessions.graph_encoder, ["nodes_out"], inputs, "graph attention")
        np.testing.assert_allclose(nodes, graphs[f"{part}.nodes_out"], rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("stage", STAGES)
def test_decoders(graphmotion: MotionPipeline, stage: int) -> None:
    vae = official("gm_small.vae.npz")
    latent = vae[f"stage{stage}.z_in"].swapaxes(0, 1)
    session = graphmotion.encoder.sessions.decoder_of(STAGES[stage])
    inputs = {"latent": latent, "frame_mask": frame_mask(vae["lengths"])}
    (features,) = run_model(session, ["features"], inputs, "the decoder")
    np.testing.assert_allclose(features, vae[f"stage{stage}.feats_out"], rtol=0, atol=TOLERANCE)


def fixture_conditions() -> SlotConditions:
    """Nodes after the official graph attention, and the masks, of two captions."""
    graphs = official("gm_small.graph.npz")
    null, nodes = graphs["eval.nodes_out"][:2], graphs["eval.nodes_out"][2:]
    exists = np.concatenate([np.ones((2, 1)), graphs["eval.act_mask"][2:], graphs["eval.ent_mask"][2:]], axis=1)
    bias = np.where(exists, 0.0, PADDING_BIAS).astype(np.float32)
    kind = np.tile(slot_kinds(), (2, 1))
    return SlotConditions(nodes, kind, np.zeros_like(kind), bias, np.zeros((2, 1), dtype=np.float32), null)


@pytest.fixture(scope="module")
def sampled(graphmotion: MotionPipeline) -> tuple[Arrays, dict[str, np.ndarray]]:
    """The official run of three levels, and ours from the same noise: latents of both halves by level."""
    expected = official("gm_small.sample.npz")
    noise = [expected[f"stage{stage}.noise"] for stage in STAGES]
    options = [resolve_options(graphmotion.manifest, seconds=2, seed=0)] * 2
    assert isinstance(graphmotion.sampler, ConcatSampler)
    halves = graphmotion.sampler.sample_halves(fixture_conditions(), None, options, noise)
    return expected, dict(zip(LEVELS, halves, strict=True))


@pytest.mark.parametrize("stage", STAGES)
def test_sampling_of_three_levels(sampled: tuple[Arrays, dict[str, np.ndarray]], stage: int) -> None:
    expected, latents = sampled
    unconditional, conditional = np.split(latents[STAGES[stage]], 2)
    # random networks under a guidance of 7.5 over 50 steps: values to 68, of which this is a hundred-thousandth
    limit = 1e-3
    assert np.abs(expected[f"stage{stage}.latent_final"]).max() > 40
    np.testing.assert_allclose(conditional, expected[f"stage{stage}.latent_final"], rtol=0, atol=limit)
    wanted = expected[f"stage{stage}.latent_uncond_final"]
    np.testing.assert_allclose(unconditional, wanted, rtol=0, atol=limit)
    assert np.abs(unconditional - conditional).max() > 10 * limit, "the halves part at the last step"


@pytest.mark.parametrize("stage", STAGES)
def test_features_and_joints(
    graphmotion: MotionPipeline, sampled: tuple[Arrays, dict[str, np.ndarray]], stage: int
) -> None:
    expected, latents = sampled
    session = graphmotion.encoder.sessions.decoder_of(STAGES[stage])
    inputs = {"latent": np.split(latents[STAGES[stage]], 2)[1], "frame_mask": frame_mask(expected["lengths"])}
    (features,) = run_model(session, ["features"], inputs, "the decoder")
    np.testing.assert_allclose(features, expected[f"stage{stage}.feats"], rtol=0, atol=2e-3)
    rows = expected[f"stage{stage}.feats"] * expected["std"] + expected["mean"]
    for row, joints in zip(rows, expected[f"stage{stage}.joints"], strict=True):
        np.testing.assert_allclose(joints_from_humanml3d(row), joints, rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("stage", STAGES)
def test_one_step(graphmotion: MotionPipeline, stage: int) -> None:
    expected = official("gm_small.sample.npz")
    options = [resolve_options(graphmotion.manifest, seconds=2, seed=0)] * 2
    sampler = graphmotion.sampler
    coarse = expected[f"stage{stage}.coarser_z"].swapaxes(0, 1) if stage > 1 else None
    ddim = ddim_coefficients(sampler.schedule, 50)
    np.testing.assert_array_equal(ddim.timesteps, expected[f"stage{stage}.timesteps"])
    predictor = sampler.predictor(fixture_conditions(), None, options, STAGES[stage], ddim, coarse)
    assert isinstance(predictor, ConcatPrediction)
    stride = int(expected["record_stride"][0])
    for record, after in enumerate(expected[f"stage{stage}.latents_after_step"]):
        index = stride * (record + 1) - 1
        guided = expected[f"stage{stage}.eps_guided"][record]
        # the latents before the step, from those after it: z' = keep z + move eps
        before = ((after - ddim.move[index] * guided) / ddim.keep[index]).astype(np.float32)
        unconditional, conditional = predictor.predict(before, index)
        wanted = expected[f"stage{stage}.eps_uncond"][record]
        np.testing.assert_allclose(unconditional, wanted, rtol=0, atol=TOLERANCE)
        ours = unconditional + 7.5 * (conditional - unconditional)
        np.testing.assert_allclose(ours, guided, rtol=0, atol=10 * TOLERANCE)  # 7.5 times the difference of two


def test_a_sentence_becomes_a_clip(graphmotion: MotionPipeline) -> None:
    clip = graphmotion.generate(GRAPH, **SHORT)
    assert clip.joints.shape == (40, 22, 3)
    assert np.isfinite(clip.joints).all()
    again = graphmotion.generate(GRAPH, **SHORT)
    np.testing.assert_array_equal(clip.joints, again.joints)
    other = graphmotion.generate(WAVES, **SHORT)
    assert distance(clip.joints, other.joints) > TOLERANCE


def test_plain_text_needs_the_parser_alone(graphmotion: MotionPipeline) -> None:
    pytest.importorskip("spacy")
    clip = graphmotion.generate("a person walks slowly to the left", **SHORT)
    assert clip.graph is not None
    assert [action.text for action in clip.graph.actions] == ["walks"]


def test_one_concept_is_plain_guidance(graphmotion: MotionPipeline) -> None:
    plain = graphmotion.generate(GRAPH, **SHORT)
    latent = graphmotion.compose([GRAPH], method="latent", **SHORT)
    fused = graphmotion.compose([GRAPH], method="fused", lambdas=(0.3, 0.0, 0.7), **SHORT)
    assert distance(plain.joints, latent.joints) <= TOLERANCE
    assert distance(plain.joints, fused.joints) <= TOLERANCE


def test_negation_leads_away(graphmotion: MotionPipeline) -> None:
    plain = graphmotion.compose([GRAPH], method="latent", **SHORT)
    with_both = graphmotion.compose([GRAPH, WAVES], method="latent", **SHORT)
    without = graphmotion.compose([GRAPH, Concept(WAVES, weight=-1.0)], method="latent", **SHORT)
    assert distance(plain.joints, with_both.joints) > TOLERANCE
    assert distance(plain.joints, without.joints) > TOLERANCE
    assert distance(with_both.joints, without.joints) > TOLERANCE


def test_what_works_inside_cross_attention_says_why_not(graphmotion: MotionPipeline) -> None:
    for refused in ({"method": "semantic"}, {"method": "fused"}, {"method": "latent", "agd": (0.1, 0.1)}):
        with pytest.raises(InvalidInputError, match=r"one sequence.*method 'latent'"):
            graphmotion.compose([GRAPH, WAVES], **refused, **SHORT)


def test_a_composition_is_the_sum_of_eq_7(graphmotion: MotionPipeline) -> None:
    """eps = mean u + s sum_i w_i (c_i - u_i), from predictions of single graphs."""
    sampler, encoder = graphmotion.sampler, graphmotion.encoder
    options = resolve_options(graphmotion.manifest, seconds=2, seed=0)
    ddim = ddim_coefficients(sampler.schedule, 4)
    features = encoder.encode_text([GRAPH, WAVES])
    latents = np.random.Generator(np.random.PCG64(1)).standard_normal((1, *_latent(graphmotion))).astype(np.float32)

    def predict(*graphs: int, weights: CompositionWeights | None = None) -> np.ndarray:
        conditions = encoder.attend([features[index] for index in graphs])
        predictor = sampler.predictor(conditions, weights, [options], LEVELS[0], ddim, None)
        return predictor(np.concatenate([latents, latents]), 3)

    (u1, g1), (u2, g2) = predict(0), predict(1)
    composed = predict(0, 1, weights=CompositionWeights((1.0,), negated=(-0.5,)))
    # 1 * walking - 0.5 * waving; the base is that of what should happen
    lift1, lift2 = g1 - u1, g2 - u2
    np.testing.assert_allclose(composed[1], u1 + lift1 - 0.5 * lift2, rtol=0, atol=1e-4)
    np.testing.assert_allclose(composed[0], u1, rtol=0, atol=1e-5)


def _latent(pipe: MotionPipeline) -> tuple[int, int]:
    spec = pipe.manifest.levels[LEVELS[0]]
    return spec.tokens, spec.latent_width


def test_a_batch_is_its_clips(graphmotion: MotionPipeline) -> None:
    together = graphmotion.batch([GRAPH, WAVES], shared_run=True, **SHORT)
    alone = graphmotion.batch([GRAPH, WAVES], **SHORT)
    for a, b in zip(together, alone, strict=True):
        assert distance(a.joints, b.joints) <= TOLERANCE


def test_nodes_without_a_slot_are_told(graphmotion: MotionPipeline) -> None:
    caption = "he runs jumps turns waves bows"
    words = caption.split()[1:]
    spans = [(caption.index(word), caption.index(word) + len(word)) for word in words]
    actions = tuple(Action(word, *span, order) for order, (word, span) in enumerate(zip(words, spans, strict=True)))
    clip = graphmotion.compose([SemanticGraph(caption, actions)], method="latent", **SHORT)
    assert any("room for 4 actions" in note and "'bows'" in note for note in clip.notes)


def test_previews_of_coarser_levels(graphmotion: MotionPipeline) -> None:
    seen = {}
    graphmotion.generate(GRAPH, on_level=lambda level, clip: seen.update({level: clip}), **SHORT)
    assert list(seen) == list(LEVELS[:-1])
    assert all(clip.joints.shape == (40, 22, 3) for clip in seen.values())


def test_energy_maps_are_refused(graphmotion: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match="own networks"):
        energy_maps(graphmotion, [GRAPH, WAVES])


def test_captions_longer_than_clip_reads(graphmotion: MotionPipeline) -> None:
    caption = "a man waves " + "and waves " * 40
    graph = SemanticGraph(caption.strip(), WAVES.actions)
    with pytest.raises(InvalidInputError, match="at most 77"):
        graphmotion.generate(graph, **SHORT)


def test_the_bundle_verifies(graphmotion_bundle: Path) -> None:
    report = verify_bundle(graphmotion_bundle)
    assert {"graph_encoder", *(f"denoiser_{level}" for level in LEVELS)} <= set(report.sessions)

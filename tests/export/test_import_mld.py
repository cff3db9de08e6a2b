"""MLD's checkpoint as a bundle of one level: the official modules' numbers through onnxruntime."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnx")

from kinegraph import Concept, MotionPipeline
from kinegraph.bench import GRAPH
from kinegraph.bundle.sessions import run_model
from kinegraph.bundle.verify import verify_bundle
from kinegraph.concat_denoising import ConcatPrediction, ConcatSampler
from kinegraph.diffusion.sampling import ddim_coefficients
from kinegraph.edits import with_weight
from kinegraph.errors import InvalidInputError
from kinegraph.graph import Action, SemanticGraph
from kinegraph.options import resolve_options
from kinegraph.slot_conditioning import SlotConditions, slot_kinds
from kinegraph_export.import_mld import import_mld
from support.official import mld_tensors, write_clip, write_lightning, write_statistics
from support.shared import SHARED, shared_path

Arrays = Mapping[str, np.ndarray]
pytestmark = pytest.mark.slow
TOLERANCE = 1e-4
SHORT = {"seconds": 2, "seed": 3, "steps": 4}
WAVES = SemanticGraph("a man waves", (Action("waves", 6, 11, 0),))


@pytest.fixture(scope="module")
def bundle(traces: object, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a float32 bundle of the official modules' random weights, where they are at hand."""
    folder = tmp_path_factory.mktemp("mld")
    official = SHARED / "fixtures" / "official" / "mld.weights.safetensors"
    checkpoint = official if official.is_file() else write_lightning(folder / "mld.ckpt", mld_tensors())
    clip, stats = write_clip(folder / "clip"), write_statistics(folder / "stats")
    import_mld(checkpoint, clip, stats, folder / "bundle", precision="fp32")
    return folder / "bundle"


@pytest.fixture(scope="module")
def mld(bundle: Path) -> MotionPipeline:
    return MotionPipeline.load(bundle, threads=1)


def official(name: str) -> Arrays:
    with np.load(shared_path("fixtures", "official", name), allow_pickle=False) as pack:
        return dict(pack)


def conditions(text: np.ndarray) -> SlotConditions:
    """Sentence features (2A, 1, D), those of empty captions first, in the first slot."""
    count = len(text) // 2
    nodes = np.zeros((2 * count, 13, text.shape[-1]), dtype=np.float32)
    nodes[:, :1] = text
    kind = np.tile(slot_kinds(), (count, 1))
    bias = np.zeros(kind.shape, dtype=np.float32)
    return SlotConditions(nodes[count:], kind, np.zeros_like(kind), bias, np.zeros((count, 1)), nodes[:count])


def test_one_step(mld: MotionPipeline) -> None:
    expected = official("mld.denoise.npz")
    sessions = mld.encoder.sessions
    (condition,) = run_model(
        sessions.context["specific"], ["condition"], {"nodes": expected["text_emb"]}, "the context encoder"
    )
    for timestep in (0, 1, 101, 501, 951, 999):
        inputs = {"timestep": np.array([timestep])}
        (time,) = run_model(sessions.modulation["specific"], ["time"], inputs, "the time embedding")
        rows = len(condition)
        feeds = {
            "latent": expected["sample"],
            "time": np.repeat(time, rows, axis=0),
            "condition": condition,
            "mask": np.ones((rows, 1), dtype=np.float32),
        }
        (noise,) = run_model(sessions.denoiser["specific"], ["noise"], feeds, "the denoiser")
        np.testing.assert_allclose(noise, expected[f"out_t{timestep}"], rtol=0, atol=TOLERANCE)


def test_sampling_decoding_and_joints(mld: MotionPipeline) -> None:
    expected = official("mld.sample.npz")
    count = len(expected["lengths"])
    options = [resolve_options(mld.manifest, seconds=2, seed=0)] * count
    sampler = mld.sampler
    assert isinstance(sampler, ConcatSampler)
    given = conditions(expected["text_emb"])
    (halves,) = sampler.sample_halves(given, None, options, [expected["noise"]])
    limit = TOLERANCE * np.abs(expected["latent_final"]).max()
    np.testing.assert_allclose(halves[count:], expected["latent_final"], rtol=0, atol=limit)
    mask = (np.arange(expected["lengths"].max()) < expected["lengths"][:, None]).astype(np.float32)
    inputs = {"latent": expected["latent_final"], "frame_mask": mask}
    (features,) = run_model(mld.encoder.sessions.decoder, ["features"], inputs, "the decoder")
    np.testing.assert_allclose(features, expected["feats"], rtol=0, atol=TOLERANCE)
    ddim = ddim_coefficients(sampler.schedule, 50)
    np.testing.assert_array_equal(ddim.timesteps, expected["timesteps"])
    predictor = sampler.predictor(given, None, options, "specific", ddim, None)
    assert isinstance(predictor, ConcatPrediction)
    before = expected["latents_after_step"][24]
    guided = predictor(np.concatenate([before, before]), 25)[count:]
    np.testing.assert_allclose(guided, expected["eps_guided"][25], rtol=0, atol=10 * TOLERANCE)


def test_decoder(mld: MotionPipeline) -> None:
    vae = official("mld.vae.npz")
    mask = (np.arange(vae["lengths"].max()) < vae["lengths"][:, None]).astype(np.float32)
    inputs = {"latent": vae["z_in"].swapaxes(0, 1), "frame_mask": mask}
    (features,) = run_model(mld.encoder.sessions.decoder, ["features"], inputs, "the decoder")
    np.testing.assert_allclose(features, vae["feats_out"], rtol=0, atol=TOLERANCE)


def test_a_sentence_becomes_a_clip_of_one_level(mld: MotionPipeline, bundle: Path) -> None:
    seen: list[str] = []
    clip = mld.generate(GRAPH, on_step=lambda info: seen.append(info.level), **SHORT)
    assert clip.joints.shape == (40, 22, 3)
    assert set(seen) == {"specific"}
    assert len(seen) == SHORT["steps"]
    assert "graph_encoder" not in verify_bundle(bundle).sessions


def test_the_sentence_alone_is_seen(mld: MotionPipeline) -> None:
    plain = mld.generate(GRAPH, **SHORT)
    graph = GRAPH.from_dict({**GRAPH.to_dict(), "actions": GRAPH.to_dict()["actions"][:1]})
    np.testing.assert_array_equal(mld.generate(graph, **SHORT).joints, plain.joints)
    # the weight of an edge composes the sentence with one that lacks its words
    lighter = mld.generate(with_weight(GRAPH, 1, 0.5), **SHORT)
    assert np.abs(lighter.joints - plain.joints).max() > 0


def test_levels_that_it_does_not_have(mld: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match=r"one number or 1, not 3"):
        mld.generate(GRAPH, steps=[3, 3, 3])
    with pytest.raises(InvalidInputError, match=r"unknown level 'motion'; the levels are \['specific'\]"):
        mld.generate(GRAPH, guidance={"motion": 2.0})


def test_concepts_compose(mld: MotionPipeline) -> None:
    plain = mld.generate(GRAPH, **SHORT)
    one = mld.compose([GRAPH], method="latent", **SHORT)
    np.testing.assert_allclose(one.joints, plain.joints, rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize(
    ("refused", "what"),
    [
        ({"method": "semantic"}, r"semantic-aware term \(EnergyMoGen, Eq\. 9\)"),
        ({"method": "fused"}, r"semantic-aware term \(EnergyMoGen, Eq\. 9\)"),
        ({"method": "latent", "agd": (0.1, 0.1)}, r"agd \(EnergyMoGen, Eq\. 3, 4\)"),
    ],
)
def test_what_works_inside_attention_says_why_not(mld: MotionPipeline, refused: dict[str, Any], what: str) -> None:
    with pytest.raises(InvalidInputError, match=rf"{what} works inside cross-attention.* have none.*method 'latent'"):
        mld.compose([GRAPH, WAVES], **refused, **SHORT)


def test_a_concept_is_negated(mld: MotionPipeline) -> None:
    plain = mld.compose([GRAPH], method="latent", **SHORT)
    without = mld.compose([GRAPH, Concept(WAVES, weight=-1.0)], method="latent", **SHORT)
    assert without.joints.shape == plain.joints.shape and np.abs(without.joints - plain.joints).max() > 1e-4

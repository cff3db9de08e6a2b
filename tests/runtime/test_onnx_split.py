"""The two parts of a gradient's graph: together they give what the whole gives, and refuse what is none."""

from __future__ import annotations

import numpy as np
import onnxruntime
import pytest

from kinegraph import MotionPipeline
from kinegraph.bundle.contract import DECODER_GRADIENTS, LEVELS
from kinegraph.bundle.onnx_inspect import summarise, with_initializers
from kinegraph.bundle.onnx_split import split_gradient
from kinegraph.errors import BundleFormatError, ModelError
from support.synthetic_bundle import model, node
from support.toy import TOY_BUNDLE

FRAMES = 24


def whole_graph(level: str) -> bytes:
    """Read the graph of a level's gradient, with the weights of its decoder."""
    name = DECODER_GRADIENTS[level]
    source = TOY_BUNDLE / f"{name.removesuffix('_vjp')}.onnx"
    return with_initializers((TOY_BUNDLE / f"{name}.onnx").read_bytes(), source.read_bytes(), source.name)


@pytest.mark.parametrize("level", LEVELS)
def test_the_parts_give_what_the_whole_gives(toy: MotionPipeline, level: str) -> None:
    spec, sessions, rng = toy.manifest.levels[level], toy.sampler.sessions, np.random.default_rng(5)
    latent = rng.normal(size=(1, spec.tokens, spec.latent_width)).astype(np.float32)
    mask = np.ones((1, FRAMES), dtype=np.float32)
    mask[0, -3:] = 0.0
    inputs = {"latent": latent, "frame_mask": mask}
    features, back = sessions.decoder_gradients[level]().decode(inputs)
    np.testing.assert_allclose(features, sessions.decoder_of(level).run(None, inputs)[0], atol=1e-4)
    whole = onnxruntime.InferenceSession(whole_graph(level), providers=["CPUExecutionProvider"])
    for _ in range(2):  # the way back can be gone again
        cotangent = rng.normal(size=features.shape).astype(np.float32) * mask[..., None]
        (expected,) = whole.run(["gradient"], {**inputs, "cotangent": cotangent})
        np.testing.assert_allclose(back(cotangent), expected, atol=1e-4 * np.abs(expected).max())
    direction = rng.normal(size=latent.shape).astype(np.float32)
    decoder = sessions.decoder_gradients[level]()
    ends = [decoder.decode({**inputs, "latent": latent + sign * 2e-3 * direction})[0] for sign in (1, -1)]
    along = float((cotangent.astype(np.float64) * (ends[0] - ends[1])).sum()) / 4e-3
    sizes = float(np.linalg.norm(expected) * np.linalg.norm(direction))
    assert float((back(cotangent) * direction).sum()) == pytest.approx(along, abs=0.02 * sizes)


def test_the_decoder_is_not_run_again_on_the_way_back() -> None:
    whole = whole_graph(LEVELS[-1])
    parts = split_gradient(whole, "decoder_vjp.onnx")
    assert len(parts.forward) + len(parts.backward) < 2 * len(whole) and parts.kept
    forward, backward = (
        onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
        for data in (parts.forward, parts.backward)
    )
    given = {tensor.name for tensor in forward.get_outputs()}
    assert given == {"features", *parts.kept} and [tensor.name for tensor in backward.get_outputs()] == ["gradient"]
    read = {tensor.name for tensor in backward.get_inputs()}
    assert {*parts.kept, "cotangent"} <= read <= {*parts.kept, "cotangent", "latent", "frame_mask"}
    # the decoder's attention and norms are in the first part alone
    assert "ai.onnx::LayerNormalization" in summarise(parts.forward, "f").operators
    assert "ai.onnx::LayerNormalization" not in summarise(parts.backward, "b").operators


def test_no_gradient_is_refused() -> None:
    with pytest.raises(BundleFormatError, match=r"g\.onnx has no tensor 'features'"):
        split_gradient(model([node("Add", ["x", "x"], ["gradient"])]), "g.onnx")
    with pytest.raises(BundleFormatError, match=r"g\.onnx has no tensor 'gradient'"):
        split_gradient(model([node("Add", ["x", "x"], ["features"])]), "g.onnx")
    with pytest.raises(BundleFormatError, match=r"g\.onnx is not an ONNX model"):
        split_gradient(whole_graph(LEVELS[0])[:-3], "g.onnx")
    assert split_gradient(
        model([node("Add", ["x", "x"], ["features"]), node("Mul", ["features", "x"], ["gradient"])]), "g"
    ).kept


def test_a_wrong_cotangent_has_a_typed_error(toy: MotionPipeline) -> None:
    spec = toy.manifest.levels[LEVELS[-1]]
    latent = np.zeros((1, spec.tokens, spec.latent_width), dtype=np.float32)
    decoder = toy.sampler.sessions.decoder_gradients[LEVELS[-1]]()
    features, back = decoder.decode({"latent": latent, "frame_mask": np.ones((1, FRAMES), dtype=np.float32)})
    with pytest.raises(ModelError, match="the gradient of the decoder failed"):
        back(features[..., :-1])
    with pytest.raises(ModelError, match="the decoder failed"):
        decoder.decode({"latent": latent[..., :-1], "frame_mask": np.ones((1, FRAMES), dtype=np.float32)})

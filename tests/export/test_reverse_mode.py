"""Gradients derived from the ONNX graphs of decoders: those of finite differences, with the decoders' own weights."""

from __future__ import annotations

import numpy as np
import onnxruntime
import pytest

onnx = pytest.importorskip("onnx")

from kinegraph.bundle.contract import COARSE_DECODERS, DECODER_GRADIENTS, LEVELS
from kinegraph.bundle.onnx_inspect import with_initializers
from kinegraph.bundle.reader import read_bundle
from kinegraph.errors import InvalidInputError
from kinegraph_export.reverse_mode import derive_gradient
from kinegraph_export.shared_weights import without_namesakes
from support.toy import TOY_BUNDLE


def decoder_bytes(level: str) -> bytes:
    return read_bundle(TOY_BUNDLE).read_later(f"{COARSE_DECODERS.get(level, 'decoder')}.onnx")


@pytest.mark.parametrize("level", LEVELS)
def test_a_derived_gradient_is_that_of_finite_differences(level: str) -> None:
    data = decoder_bytes(level)
    decoder = onnx.load_model_from_string(data)
    gradient = derive_gradient(decoder)
    onnx.checker.check_model(gradient)
    lean = without_namesakes(gradient, decoder)
    assert len(lean) < len(data) and gradient.SerializeToString() != lean
    run = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"]).run
    merged = with_initializers(lean, data, "decoder.onnx")
    vjp = onnxruntime.InferenceSession(merged, providers=["CPUExecutionProvider"]).run
    spec = read_bundle(TOY_BUNDLE).manifest.levels[level]
    rng = np.random.default_rng(0)
    latent = rng.standard_normal((2, spec.tokens, spec.latent_width)).astype(np.float32)
    mask = (np.arange(40) < [[40], [33]]).astype(np.float32)
    cotangent = rng.standard_normal((2, 40, 137)).astype(np.float32)
    (found,) = vjp(["gradient"], {"latent": latent, "frame_mask": mask, "cotangent": cotangent})
    for _ in range(6):
        direction = rng.standard_normal(latent.shape).astype(np.float32)
        ends = [
            run(["features"], {"latent": latent + sign * 0.002 * direction, "frame_mask": mask})[0] for sign in (1, -1)
        ]
        slope = ((ends[0].astype(np.float64) - ends[1]) * cotangent).sum() / 0.004
        assert slope == pytest.approx((found * direction).sum(), rel=0.01, abs=0.01 * float(np.linalg.norm(found)))


@pytest.mark.parametrize("level", LEVELS)
def test_the_bundle_holds_the_gradient_of_its_own_decoder(level: str) -> None:
    decoder = onnx.load_model_from_string(decoder_bytes(level))
    stored = read_bundle(TOY_BUNDLE).read_later(f"{DECODER_GRADIENTS[level]}.onnx")
    assert stored == without_namesakes(derive_gradient(decoder), decoder)


def test_an_operator_without_a_rule_is_named() -> None:
    decoder = onnx.load_model_from_string(decoder_bytes("specific"))
    next(node for node in decoder.graph.node if node.op_type == "Gelu").op_type = "Softplus"
    with pytest.raises(InvalidInputError, match="Softplus"):
        derive_gradient(decoder)

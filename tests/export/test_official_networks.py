"""Autoencoders of the released networks through onnxruntime: both ways, and with KIT-ML's 251 features."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

import onnxruntime

from kinegraph.bundle.contract import LEVELS, LevelSpec, decoder
from kinegraph.bundle.onnx_inspect import summarise
from kinegraph.bundle.released_contract import released_level
from kinegraph_export.official.checkpoint import build_vae, graphmotion_models
from kinegraph_export.official.denoiser import OfficialDenoiser, OfficialDenoiserConfig
from kinegraph_export.official.graphs import (
    VaeDecoderGraph,
    VaeEncoderGraph,
    export_graph,
    level_spec,
    vae_encoder_contract,
)
from kinegraph_export.official.vae import OfficialVae, OfficialVaeConfig
from kinegraph_export.tensor_files import load_weights, read_tensors
from support.official import graphmotion_tensors, randomise
from support.shared import shared_path

pytestmark = pytest.mark.slow
TOLERANCE = 1e-4
CONFIG = OfficialVaeConfig(251, 2, 16, 3, 4, 32, 263)


def frame_mask(lengths: np.ndarray) -> np.ndarray:
    return (np.arange(lengths.max()) < lengths[:, None]).astype(np.float32)


def session(vae: OfficialVae, *, encodes: bool) -> onnxruntime.InferenceSession:
    """Export one half of an autoencoder."""
    config = vae.config
    level = LevelSpec(config.tokens, config.width, config.width, config.heads, config.layers, ("motion",))
    contract = vae_encoder_contract(vae) if encodes else decoder("decoder", level, config.features)
    data, parity = export_graph((VaeEncoderGraph if encodes else VaeDecoderGraph)(vae), contract, "fp32")
    assert parity[contract.name] <= TOLERANCE
    return onnxruntime.InferenceSession(data)


def check(vae: OfficialVae, arrays: dict[str, np.ndarray], prefix: str) -> None:
    """Compare encoder and decoder with the official numbers; latents there have their tokens first."""
    mask = frame_mask(arrays["lengths"])
    mean, log_variance = session(vae, encodes=True).run(None, {"features": arrays["motion"], "frame_mask": mask})
    np.testing.assert_allclose(mean.swapaxes(0, 1), arrays[f"{prefix}mu"], rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(log_variance.swapaxes(0, 1), arrays[f"{prefix}logvar"], rtol=0, atol=TOLERANCE)
    latent = arrays[f"{prefix}z_in"].swapaxes(0, 1)
    (features,) = session(vae, encodes=False).run(None, {"latent": latent, "frame_mask": mask})
    np.testing.assert_allclose(features, arrays[f"{prefix}feats_out"], rtol=0, atol=TOLERANCE)


def official(name: str) -> dict[str, np.ndarray]:
    with np.load(shared_path("fixtures", "official", name), allow_pickle=False) as pack:
        return dict(pack)


def test_the_autoencoder_of_a_level() -> None:
    weights = read_tensors(shared_path("fixtures", "official", "gm_small.weights.safetensors"))
    vae = graphmotion_models(weights, denoiser_heads=4).vaes[LEVELS[1]]
    check(vae, official("gm_small.vae.npz"), "stage2.")


def test_an_autoencoder_saved_by_itself() -> None:
    weights = read_tensors(shared_path("fixtures", "official", "gm_vae_d64.weights.safetensors"))
    vae = build_vae(weights, "vae.", 4)
    load_weights({"vae.": vae}, weights, "GraphMotion")
    check(vae, official("gm_vae_d64.npz"), "")


def test_kit_s_features_pass_two_more_layers() -> None:
    tensors = graphmotion_tensors(251)
    vae = graphmotion_models(tensors, denoiser_heads=4).vaes[LEVELS[0]]
    assert (vae.config.features, vae.config.embedded) == (251, 263)
    latent = np.random.Generator(np.random.PCG64(0)).standard_normal((2, 2, 16)).astype(np.float32)
    mask = frame_mask(np.array([30, 20]))
    (features,) = session(vae, encodes=False).run(None, {"latent": latent, "frame_mask": mask})
    assert features.shape == (2, 30, 251)
    # padding is zeroed before the last layer, so it equals its bias
    bias = tensors["vae_stage1.output_proj.bias"].numpy()
    np.testing.assert_allclose(features[1, 20:], np.tile(bias, (10, 1)), atol=1e-6)
    # the same weights without the two layers: what they do is one affine map each way
    inner = OfficialVae(OfficialVaeConfig(263, 2, 16, 3, 4, 32, 263))
    layers = ("input_proj", "output_proj")
    own = {name: value for name, value in vae.state_dict().items() if not name.startswith(layers)}
    inner.load_state_dict(own)
    with torch.no_grad():
        decoded = inner.eval().decode(torch.from_numpy(latent), torch.from_numpy(mask)).numpy()
    weight = tensors["vae_stage1.output_proj.weight"].numpy()
    np.testing.assert_allclose(features, decoded @ weight.T + bias, atol=TOLERANCE)


def test_padding_changes_no_frame() -> None:
    vae = randomise(OfficialVae(CONFIG), 1).eval()
    latent = torch.randn(1, 2, 16, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        alone = vae.decode(latent, torch.ones(1, 12))
        padded = vae.decode(latent, torch.cat([torch.ones(1, 12), torch.zeros(1, 9)], dim=1))
        mean = vae.encode(alone, torch.ones(1, 12))[0]
        mean_padded = vae.encode(padded, torch.cat([torch.ones(1, 12), torch.zeros(1, 9)], dim=1))[0]
    torch.testing.assert_close(padded[:, :12], alone, rtol=0, atol=1e-5)
    torch.testing.assert_close(mean_padded, mean, rtol=0, atol=1e-5)


def test_self_attention_has_the_operator_that_is_fast_in_its_precision() -> None:
    denoiser = randomise(OfficialDenoiser(OfficialDenoiserConfig(2, 16, 32, 3, 4, 64, 24, is_lifted=True)), 1).eval()
    contract = released_level("motion", level_spec(denoiser, 1), 24, None)[-1]
    assert contract.name == "denoiser_motion"
    exact, parity = export_graph(denoiser, contract, "fp32")
    small, _ = export_graph(denoiser, contract, "int8")
    assert parity[contract.name] <= TOLERANCE
    found = {name: set(summarise(data, name).operators) for name, data in (("fp32", exact), ("int8", small))}
    assert not any("com.microsoft::Attention" in operators for operators in found.values())
    assert "com.microsoft::MultiHeadAttention" in found["fp32"] and "com.microsoft::QAttention" in found["int8"]

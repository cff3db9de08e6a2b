"""Recover a training run from a bundle, by reading the weights of denoisers and decoders back out of its graphs.

A bundle holds all weights but those of the encoders, which `--vaes` gives. The run can be trained further or exported
anew (in another precision, with further graphs) if its checkpoints are gone.

    python -m kinegraph_export.recover --bundle BUNDLE --preset studio --vaes weights/studio --run runs/recovered \
        --data DATA --held-out PAIRS

The exporter moves, transposes and renames weights. To find where each one went, modules of the same shape are exported
whose weights are all different numbers (the probe). The recovered weights are those that the bundle holds, rounded to
float16 or int8: good enough to train further, and from an fp32 bundle the same graphs again.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import nn

from kinegraph.bundle.contract import (
    COARSE_DECODERS,
    CONTEXT_MIXING_VERSION,
    LEVELS,
    OPTIONAL_GRAPHS,
    GraphContract,
    contracts,
)
from kinegraph.bundle.reader import Bundle, read_bundle
from kinegraph.bundle.vocabulary import FILE as VOCABULARY
from kinegraph.errors import InvalidInputError
from kinegraph_export.graphs import TrainedModels, graph_modules, trace_to_onnx
from kinegraph_export.modules import CoarseDecoderGraph, DecoderGraph
from kinegraph_training.bundle_tables import write_tables
from kinegraph_training.checkpoints import read_checkpoint
from kinegraph_training.config import Preset, read_preset
from kinegraph_training.dataset import drop_long_clips, training_set
from kinegraph_training.latents import encode_clips, read_vae, standardise
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy
from kinegraph_training.models.vae import ENCODER_PARTS, MotionVae, VaeConfig

FloatArrays = dict[str, np.ndarray]

QUANTISED = (("_quantized", "_scale"), (".int8", ".scale"))
"""Suffixes of a tensor's int8 weights and of their scale: those of onnxruntime's quantiser, and of `store_int8`."""


def dequantised_weights(model: onnx.ModelProto) -> FloatArrays:
    """Read the floating-point weights of a graph as float32, by name.

    Weights stored as float16 get the name that they are widened to; int8 weights are multiplied by their scale.
    """
    arrays = {tensor.name.removesuffix(".half"): numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    weights = {name: value.astype(np.float32) for name, value in arrays.items() if value.dtype.kind == "f"}
    for int8, scale in QUANTISED:
        for name in [name for name in arrays if name.endswith(int8)]:
            tensor_name = name.removesuffix(int8)
            weights[tensor_name] = arrays[name].astype(np.float32) * weights.pop(f"{tensor_name}{scale}")
    return weights


def stored_layouts(value: np.ndarray) -> Iterator[np.ndarray]:
    """View a weight in each layout that an exporter may store: as it is, transposed, or row by row."""
    yield value
    if value.ndim == 2:
        yield value.T
    if value.ndim > 1:
        yield from value


def copy_matching_weights(
    probe: Mapping[str, np.ndarray], stored: Mapping[str, np.ndarray], weights: Mapping[str, np.ndarray]
) -> None:
    """Copy the weights of `stored` into `weights`, to where the numbers of `probe` came from.

    Args:
        probe: the weights of the exported probe by their names in the module.
        stored: per initializer, the probe's value and the bundle's, stacked: (2, ...).
        weights: arrays of the probe's shapes, by name, filled with NaN.
    """
    for probe_value, value in stored.values():
        for name, weight in probe.items():
            for layout, target in zip(stored_layouts(weight), stored_layouts(weights[name]), strict=True):
                if layout.shape == probe_value.shape and np.array_equal(layout, probe_value):
                    target[...] = value


def recover_module(
    module: nn.Module,
    weights: Mapping[str, nn.Parameter],
    contract: GraphContract,
    frames_per_token: int,
    data: bytes,
) -> None:
    """Load the weights of an exported graph into its module.

    Args:
        module: of the graph.
        weights: parameters of the module that the graph holds; they are replaced.
        contract: of the graph.
        frames_per_token: which the number of frames is a multiple of.
        data: ONNX bytes of the graph.

    Raises:
        InvalidInputError: the graph is not the export of such a module by these versions of torch and onnx.
    """
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for weight in weights.values():
            weight.copy_(torch.randn(weight.shape, generator=generator))
    model = trace_to_onnx(module, contract, frames_per_token)
    probed, stored = dequantised_weights(model), dequantised_weights(onnx.load_model_from_string(data))
    if {name: value.shape for name, value in probed.items()} != {name: value.shape for name, value in stored.items()}:
        raise InvalidInputError(
            f"{contract.file} is not what this preset and these versions of torch and onnx export; "
            "take those of the bundle's provenance"
        )
    probe = {name: weight.detach().numpy().copy() for name, weight in weights.items()}
    recovered = {name: np.full_like(weight, np.nan) for name, weight in probe.items()}
    copy_matching_weights(probe, {name: np.stack([probed[name], stored[name]]) for name in probed}, recovered)
    missing = [name for name, value in recovered.items() if np.isnan(value).any()]
    if missing:
        raise InvalidInputError(f"{contract.file} does not hold {', '.join(missing)}")
    with torch.no_grad():
        for name, weight in weights.items():
            weight.copy_(torch.from_numpy(recovered[name]))


def store_encoder(checkpoint: Path, out: Path) -> None:
    """Write the encoder of a trained autoencoder in float16, without its decoder and the state of the optimiser.

    `recover` completes such a checkpoint by the decoder of a bundle.

    Args:
        checkpoint: of `train_vae`.
        out: checkpoint to write.
    """
    state = read_checkpoint(checkpoint)
    weights = {}
    for name, value in state["state_dict"].items():
        if not name.startswith("vae."):  # the normalisation of features
            weights[name] = value
        elif name.split(".")[1] in ENCODER_PARTS:
            weights[name] = value.half()
    torch.save({"hyper_parameters": state["hyper_parameters"], "state_dict": weights}, out)


def recover_autoencoder(bundle: Bundle, level: str, checkpoint: Path, contract: GraphContract) -> dict[str, Any]:
    """Complete the checkpoint of an encoder by the decoder that a bundle holds.

    Args:
        bundle: to read.
        level: of the autoencoder.
        checkpoint: of `store_encoder`; that of a whole autoencoder is returned as it is.
        contract: of the level's decoder.

    Raises:
        InvalidInputError: the checkpoint lacks weights of the encoder, or the bundle has no decoder for it.
    """
    state = read_checkpoint(checkpoint)
    vae = MotionVae(VaeConfig(**state["hyper_parameters"]["config"])).eval()
    encoder = {name.removeprefix("vae."): v for name, v in state["state_dict"].items() if name.startswith("vae.")}
    missing = {name.split(".")[0] for name in vae.load_state_dict(encoder, strict=False).missing_keys}
    if not missing:
        return state
    if missing & ENCODER_PARTS:
        raise InvalidInputError(f"{checkpoint} lacks {', '.join(sorted(missing & ENCODER_PARTS))} of the encoder")
    manifest, spec, config = bundle.manifest, bundle.manifest.levels[level], vae.config
    if contract.file not in manifest.files:
        raise InvalidInputError(f"{checkpoint} is of an encoder alone, and the bundle has no {contract.file}")
    if (config.tokens, config.latent_width) != (spec.tokens, spec.latent_width):
        raise InvalidInputError(
            f"{checkpoint} has {config.tokens} latent tokens of width {config.latent_width}, "
            f"the bundle {spec.tokens} of {spec.latent_width}: they are not of one model"
        )
    # Standardisation and normalisation are not recovered. Their probes are different numbers, as the exporter would
    # store equal ones once, and not 0 or 1, as it would leave out the arithmetic.
    generator = torch.Generator().manual_seed(1)
    centre, scale = torch.rand(2, config.tokens, config.latent_width, generator=generator) + 2
    gain, shift = torch.rand(2, config.features, generator=generator) + 2
    fine = level == LEVELS[-1]
    module = DecoderGraph(vae, centre, scale) if fine else CoarseDecoderGraph(vae, centre, scale, gain, shift)
    data = bundle.read_graph(contract.file)
    weights = {name: value for name, value in vae.named_parameters() if name.split(".")[0] not in ENCODER_PARTS}
    recover_module(module.eval(), weights, contract, manifest.frames.per_token, data)
    state["state_dict"] |= {f"vae.{name}": value.detach() for name, value in weights.items()}
    return state


def recover_hierarchy(bundle: Bundle, config: DenoiserConfig, run: Path) -> tuple[Hierarchy, FloatArrays]:
    """Recover the denoisers of a bundle, and the statistics (c, z) of the latents whose decoders it holds.

    Args:
        bundle: to read.
        config: of the denoisers.
        run: folder with the autoencoders.
    """
    manifest = bundle.manifest
    shapes = {level: LatentShape(spec.tokens, spec.latent_width) for level, spec in manifest.levels.items()}
    hierarchy = Hierarchy(config, shapes).eval()
    specific = read_vae(run / f"vae_{LEVELS[-1]}" / "last.ckpt")
    declared = contracts(manifest.levels, config.text_width, len(manifest.features.mean))
    statistics = {}
    for level, graph in ((LEVELS[-1], "decoder"), *COARSE_DECODERS.items()):
        file = declared[graph].file
        if file in manifest.files:
            data = bundle.read_graph(file)
            decoder = dequantised_weights(onnx.load_model_from_string(data))
            statistics |= {f"{level}_{name}": decoder[name] for name in ("centre", "scale")}
    unit = torch.ones(shapes[LEVELS[-1]].tokens, shapes[LEVELS[-1]].width)
    for name, module in graph_modules(TrainedModels(hierarchy, specific.vae, unit, unit)).items():
        if name != "decoder" and name not in OPTIONAL_GRAPHS:
            contract = declared[name]
            weights = dict(module.named_parameters())
            recover_module(module, weights, contract, manifest.frames.per_token, bundle.read_graph(contract.file))
    return hierarchy, statistics


def coarse_statistics(run: Path, data: Path, held_out: Path | None, preset: Preset) -> FloatArrays:
    """Measure the statistics of the coarser levels' latents on the clips that the bundle was trained on."""
    train = drop_long_clips(training_set(data, preset.data, held_out), preset.data.max_frames)
    statistics = {}
    for level in COARSE_DECODERS:
        latents = standardise(*encode_clips(read_vae(run / f"vae_{level}" / "last.ckpt"), train))
        statistics |= {f"{level}_centre": latents.centre.numpy(), f"{level}_scale": latents.scale.numpy()}
    return statistics


def recover(
    folder: Path, preset: str, vaes: Path, run: Path, data: Path | None = None, held_out: Path | None = None
) -> None:
    """Write a run as if it had been trained: autoencoders, denoisers, the bundle's tables and its vocabulary.

    Args:
        folder: of the bundle.
        preset: that the bundle was trained with.
        vaes: folder of the autoencoders' checkpoints `vae_{level}.ckpt`, whole or of the encoders alone.
        run: folder to write.
        data: training data, needed to give a bundle without coarse decoders the statistics for them.
        held_out: pairs that training never joined, as in `train_denoisers`.

    Raises:
        BundleError: the bundle cannot be read.
        InvalidInputError: it was not exported from this preset, is of an older format, or lacks a decoder whose
            weights `vaes` lack too.
    """
    bundle, config = read_bundle(folder), read_preset(preset)
    manifest = bundle.manifest
    if manifest.format_version < CONTEXT_MIXING_VERSION:
        raise InvalidInputError(
            f"the bundle has format {manifest.format_version}, and denoisers of format {CONTEXT_MIXING_VERSION} have "
            "further weights; recover it with the kinegraph that exported it"
        )
    declared = contracts(manifest.levels, config.denoiser.text_width, len(manifest.features.mean))
    for level in LEVELS:
        contract = declared[COARSE_DECODERS.get(level, "decoder")]
        state = recover_autoencoder(bundle, level, vaes / f"vae_{level}.ckpt", contract)
        (run / f"vae_{level}").mkdir(parents=True, exist_ok=True)
        torch.save(state, run / f"vae_{level}" / "last.ckpt")
    hierarchy, statistics = recover_hierarchy(bundle, config.denoiser, run)
    if data is not None:
        statistics = coarse_statistics(run, data, held_out, config) | statistics
    shapes = {level: asdict(shape) for level, shape in hierarchy.latents.items()}
    settings = {"config": asdict(config.denoiser), "training": asdict(config.denoiser_training), "latents": shapes}
    state = {f"hierarchy.{name}": value for name, value in hierarchy.state_dict().items()}
    state |= {name: torch.from_numpy(value) for name, value in statistics.items()}
    (run / "denoisers").mkdir(parents=True, exist_ok=True)
    torch.save({"hyper_parameters": settings, "state_dict": state}, run / "denoisers" / "last.ckpt")
    if VOCABULARY in bundle.files:
        (run / VOCABULARY).write_bytes(bundle.files[VOCABULARY])
    with np.load(io.BytesIO(bundle.files["tables.npz"]), allow_pickle=False) as tables:
        write_tables(run, dict(tables))


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.recover", description=__doc__.split("\n")[0])
    parser.add_argument("--bundle", type=Path, required=True, help="folder of the bundle")
    parser.add_argument("--preset", default="edge", help="preset that the bundle was trained with")
    parser.add_argument(
        "--vaes", type=Path, required=True, help="folder with vae_{motion,action,specific}.ckpt, encoders at least"
    )
    parser.add_argument("--run", type=Path, required=True, help="folder of the run to write")
    parser.add_argument("--data", type=Path, help="training data, needed where the bundle has no coarse decoders")
    parser.add_argument("--held-out", type=Path, help="pairs that training never joined, as in train_denoisers")
    options = parser.parse_args(argv)
    recover(options.bundle, options.preset, options.vaes, options.run, options.data, options.held_out)


if __name__ == "__main__":
    main()

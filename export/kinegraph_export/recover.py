"""A training run from a bundle: the denoisers' weights are read back out of its graphs, so that they can be trained on
or exported anew (in another precision, with further graphs) where the checkpoint is gone.

    python -m kinegraph_export.recover --bundle BUNDLE --preset edge --vaes weights/edge --run runs/recovered \
        --data DATA --held-out PAIRS

The exporter moves, transposes and renames weights. Where each one went is found by exporting modules of the same shape
whose weights are all different numbers. What comes back are the weights that the bundle holds, rounded to float16 or
int8: a place to train on from, and from an fp32 bundle the same graphs again.
"""

from __future__ import annotations

import argparse
import io
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import nn

from kinegraph.bundle.contract import COARSE_DECODERS, LEVELS, OPTIONAL_GRAPHS, GraphContract, contracts
from kinegraph.bundle.reader import Bundle, read_bundle
from kinegraph.errors import InvalidInputError
from kinegraph_export.graphs import Trained, graph_modules, traced
from kinegraph_training.bundle_tables import write_tables
from kinegraph_training.config import Preset, read_preset
from kinegraph_training.dataset import limit_length, training_set
from kinegraph_training.latents import encode_clips, read_vae, standardised
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy

FloatArrays = dict[str, np.ndarray]

QUANTISED = "_quantized"
"""How onnxruntime's quantiser names the int8 weights of a tensor; their scale is `{name}_scale`."""


def dequantised_weights(model: onnx.ModelProto) -> FloatArrays:
    """Floating-point weights as float32: those stored as float16 under the name they are widened to, those in int8
    multiplied by their scale."""
    arrays = {tensor.name.removesuffix(".half"): numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    found = {name: value.astype(np.float32) for name, value in arrays.items() if value.dtype.kind == "f"}
    for name in [name for name in arrays if name.endswith(QUANTISED)]:
        own = name.removesuffix(QUANTISED)
        found[own] = arrays[name].astype(np.float32) * found.pop(f"{own}_scale")
    return found


def views(value: np.ndarray) -> Iterator[np.ndarray]:
    """The ways in which an exporter may keep a weight: as it is, transposed, or row by row."""
    yield value
    if value.ndim == 2:
        yield value.T
    if value.ndim > 1:
        yield from value


def matched(probe: Mapping[str, np.ndarray], stored: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]) -> None:
    """Write into `found` (weights by name, filled with NaN) what `stored` holds, by where `probe`'s numbers went.

    Args:
        probe: the weights of the exported probe by their names in the module.
        stored: per initializer, the probe's value and the bundle's, stacked: (2, ...).
        found: arrays of the probe's shapes.
    """
    for own, value in stored.values():
        for name, weight in probe.items():
            for seen, target in zip(views(weight), views(found[name]), strict=True):
                if seen.shape == own.shape and np.array_equal(seen, own):
                    target[...] = value


def recovered(module: nn.Module, contract: GraphContract, frames_per_token: int, data: bytes) -> None:
    """Give a module the weights of its exported graph.

    Raises:
        InvalidInputError: the graph is not the export of such a module by these versions of torch and onnx.
    """
    generator = torch.Generator().manual_seed(0)
    weights = dict(module.named_parameters())
    with torch.no_grad():
        for weight in weights.values():
            weight.copy_(torch.randn(weight.shape, generator=generator))
    model = traced(module, contract, frames_per_token)
    own, stored = dequantised_weights(model), dequantised_weights(onnx.load_model_from_string(data))
    if {name: value.shape for name, value in own.items()} != {name: value.shape for name, value in stored.items()}:
        raise InvalidInputError(
            f"{contract.file} is not what this preset and these versions of torch and onnx export; "
            "take those of the bundle's provenance"
        )
    probe = {name: weight.detach().numpy().copy() for name, weight in weights.items()}
    found = {name: np.full_like(weight, np.nan) for name, weight in probe.items()}
    matched(probe, {name: np.stack([own[name], stored[name]]) for name in own}, found)
    lost = [name for name, value in found.items() if np.isnan(value).any()]
    if lost:
        raise InvalidInputError(f"{contract.file} does not hold {', '.join(lost)}")
    with torch.no_grad():
        for name, weight in weights.items():
            weight.copy_(torch.from_numpy(found[name]))


def hierarchy_of(bundle: Bundle, config: DenoiserConfig, vaes: Path) -> tuple[Hierarchy, FloatArrays]:
    """The denoisers of a bundle, and the standardisation (c, z) of the latents whose decoders it holds."""
    manifest = bundle.manifest
    shapes = {level: LatentShape(spec.tokens, spec.latent_width) for level, spec in manifest.levels.items()}
    hierarchy = Hierarchy(config, shapes).eval()
    own = read_vae(vaes / f"vae_{LEVELS[-1]}.ckpt")
    declared = contracts(manifest.levels, config.text_width, len(manifest.features.mean))
    statistics = {}
    for level, graph in ((LEVELS[-1], "decoder"), *COARSE_DECODERS.items()):
        file = declared[graph].file
        if file in manifest.files:
            data = bundle.files[file] if level == LEVELS[-1] else bundle.read_optional(file)
            decoder = dequantised_weights(onnx.load_model_from_string(data))
            statistics |= {f"{level}_{name}": decoder[name] for name in ("centre", "scale")}
    unit = torch.ones(shapes[LEVELS[-1]].tokens, shapes[LEVELS[-1]].width)
    for name, module in graph_modules(Trained(hierarchy, own.vae, unit, unit)).items():
        if name != "decoder" and name not in OPTIONAL_GRAPHS:
            contract = declared[name]
            recovered(module, contract, manifest.frames.per_token, bundle.files[contract.file])
    return hierarchy, statistics


def coarse_statistics(vaes: Path, data: Path, held_out: Path | None, preset: Preset) -> FloatArrays:
    """Standardisation of the coarser levels' latents, measured on the clips that the bundle was trained on."""
    train = limit_length(training_set(data, preset.data, held_out), preset.data.max_frames)
    found = {}
    for level in COARSE_DECODERS:
        own = standardised(*encode_clips(read_vae(vaes / f"vae_{level}.ckpt"), train))
        found |= {f"{level}_centre": own.centre.numpy(), f"{level}_scale": own.scale.numpy()}
    return found


def recover(
    folder: Path, preset: str, vaes: Path, run: Path, data: Path | None = None, held_out: Path | None = None
) -> None:
    """Write `run` as if it had been trained: the three autoencoders, the denoisers, what was measured on the data.

    Args:
        folder: of the bundle.
        preset: it was trained with.
        vaes: folder of the autoencoders' checkpoints.
        run: folder to write.
        data: training data; measures what a bundle without coarse decoders does not tell, so that the next has them.
        held_out: pairs that training never joined, as in `train_denoisers`.

    Raises:
        BundleError: the bundle cannot be read.
        InvalidInputError: it was not exported from this preset.
    """
    bundle, wanted = read_bundle(folder), read_preset(preset)
    hierarchy, statistics = hierarchy_of(bundle, wanted.denoiser, vaes)
    if data is not None:
        statistics = coarse_statistics(vaes, data, held_out, wanted) | statistics
    shapes = {level: asdict(shape) for level, shape in hierarchy.latents.items()}
    known = {"config": asdict(wanted.denoiser), "training": asdict(wanted.denoiser_training), "latents": shapes}
    state = {f"hierarchy.{name}": value for name, value in hierarchy.state_dict().items()}
    state |= {name: torch.from_numpy(value) for name, value in statistics.items()}
    (run / "denoisers").mkdir(parents=True, exist_ok=True)
    torch.save({"hyper_parameters": known, "state_dict": state}, run / "denoisers" / "last.ckpt")
    for level in LEVELS:
        (run / f"vae_{level}").mkdir(exist_ok=True)
        shutil.copyfile(vaes / f"vae_{level}.ckpt", run / f"vae_{level}" / "last.ckpt")
    with np.load(io.BytesIO(bundle.files["tables.npz"]), allow_pickle=False) as tables:
        write_tables(run, dict(tables))


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.recover", description=__doc__.split("\n")[0])
    parser.add_argument("--bundle", type=Path, required=True)
    parser.add_argument("--preset", default="edge", help="preset that the bundle was trained with")
    parser.add_argument("--vaes", type=Path, required=True, help="folder with vae_{motion,action,specific}.ckpt")
    parser.add_argument("--run", type=Path, required=True, help="folder of the run to write")
    parser.add_argument("--data", type=Path, help="training data, to give a bundle without coarse decoders them")
    parser.add_argument("--held-out", type=Path, help="pairs that training never joined, as in train_denoisers")
    arguments = parser.parse_args(argv)
    given = (arguments.bundle, arguments.preset, arguments.vaes, arguments.run, arguments.data, arguments.held_out)
    recover(*given)


if __name__ == "__main__":
    main()

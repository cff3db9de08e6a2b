"""Add the graphs of constraints and edits to a bundle that has none: gradients of its decoders, and an encoder.

    python -m kinegraph_export.add_gradients --bundle BUNDLE --vaes weights/studio

No weight is trained or changed: the gradients are derived from the decoders that the bundle holds, and the encoder
comes from `--vaes`. Denoisers with adaptive gradient descent give up the weights that the others have. Every new graph
is compared with torch, as in `export_bundle`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import onnx
import torch

from kinegraph.bundle.contract import (
    AGD_DENOISERS,
    COARSE_DECODERS,
    CONTEXT_MIXING_VERSION,
    DECODER_GRADIENTS,
    ENCODER,
    FORMAT_VERSION,
    LEVELS,
    WEIGHT_SOURCES,
    contracts,
)
from kinegraph.bundle.reader import Bundle, read_bundle
from kinegraph.bundle.verify import verify_bundle
from kinegraph.errors import InvalidInputError
from kinegraph_export.bundle_changes import unchanged_if_it_fails, with_graphs, write_files
from kinegraph_export.checkpoints import check_normalisation
from kinegraph_export.graphs import export_gradient, export_graph
from kinegraph_export.modules import CoarseDecoderGraph, DecoderGraph, EncoderGraph
from kinegraph_export.recover import dequantised_weights, recover_autoencoder
from kinegraph_export.shared_weights import without_shared
from kinegraph_training.models.vae import MotionVae, VaeConfig


def decoder_module(bundle: Bundle, level: str, vaes: Path, data: bytes) -> DecoderGraph:
    """Read the decoder of a level back out of a bundle, with its encoder from `vaes`.

    Args:
        bundle: to read.
        level: of the decoder.
        vaes: folder of the encoders, as in `recover`.
        data: ONNX bytes of the decoder.
    """
    manifest = bundle.manifest
    contract = manifest.contracts[COARSE_DECODERS.get(level, "decoder")]
    state = recover_autoencoder(bundle, level, vaes / f"vae_{level}.ckpt", contract)
    vae = MotionVae(VaeConfig(**state["hyper_parameters"]["config"]))
    weights = {name.removeprefix("vae."): value for name, value in state["state_dict"].items() if name[:4] == "vae."}
    vae.load_state_dict(weights)
    stored = dequantised_weights(onnx.load_model_from_string(data))
    names = ("centre", "scale", "gain", "shift") if level in COARSE_DECODERS else ("centre", "scale")
    constants = [torch.from_numpy(np.array(stored[name])) for name in names]
    module = CoarseDecoderGraph if level in COARSE_DECODERS else DecoderGraph
    return module(vae.float(), *constants).eval()  # type: ignore[call-arg, arg-type]


def constraint_graphs(bundle: Bundle, vaes: Path) -> tuple[dict[str, bytes], dict[str, float]]:
    """Make the gradients of a bundle's decoders and the encoder; returns files and their differences from torch.

    Raises:
        InvalidInputError: the bundle lacks a decoder, or `vaes` an encoder.
        ParityError: a graph differs from torch.
    """
    manifest = bundle.manifest
    check_normalisation(vaes / f"vae_{LEVELS[-1]}.ckpt", manifest)
    declared = contracts(manifest.levels, manifest.text.width, len(manifest.features.mean), FORMAT_VERSION)
    group = manifest.frames.per_token
    files: dict[str, bytes] = {}
    parity: dict[str, float] = {}
    for level in LEVELS:
        file = declared[COARSE_DECODERS.get(level, "decoder")].file
        if file not in manifest.files:
            raise InvalidInputError(f"the bundle has no {file}, whose gradient constraints need; export it again")
        data = bundle.read_later(file)
        module = decoder_module(bundle, level, vaes, data)
        contract = declared[DECODER_GRADIENTS[level]]
        files[contract.file], differences = export_gradient(module, contract, group, data)
        parity |= differences
        if level == LEVELS[-1]:
            encoder = EncoderGraph(module.vae, module.centre, module.scale).eval()  # type: ignore[arg-type]
            files[declared[ENCODER].file], differences = export_graph(
                encoder, declared[ENCODER], group, manifest.precision
            )
            parity |= differences
    return files, parity


def add_gradients(folder: Path, vaes: Path) -> dict[str, float]:
    """Write the graphs of constraints into a bundle's folder, and its manifest anew; returns their parity.

    Raises:
        BundleError: the bundle cannot be read, or would not be with the new graphs; it is left as it was.
        InvalidInputError: it is of an older format or of other networks; see also `constraint_graphs`.
    """
    bundle = read_bundle(folder)
    manifest = bundle.manifest
    if manifest.format_version < CONTEXT_MIXING_VERSION or manifest.family != "kinegraph":
        raise InvalidInputError(
            f"only bundles of kinegraph's own networks of format {CONTEXT_MIXING_VERSION} on can take constraints, not "
            f"format {manifest.format_version}, family {manifest.family!r}"
        )
    files, parity = constraint_graphs(bundle, vaes)
    for graph in manifest.contracts.keys() & set(AGD_DENOISERS.values()):
        file, source = (manifest.contracts[name].file for name in (graph, WEIGHT_SOURCES[graph]))
        files[file] = without_shared(bundle.read_later(file), bundle.read_later(source))
    changed = with_graphs(manifest, files, parity, format_version=FORMAT_VERSION)
    with unchanged_if_it_fails(folder, files):
        write_files(folder, changed, files)
        verify_bundle(folder)
    return parity


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.add_gradients", description=__doc__.split("\n")[0])
    parser.add_argument("--bundle", type=Path, required=True, help="folder of the bundle, changed in place")
    parser.add_argument("--vaes", type=Path, required=True, help="folder with vae_{motion,action,specific}.ckpt")
    options = parser.parse_args(argv)
    for name, difference in add_gradients(options.bundle, options.vaes).items():
        print(f"{name:24s} {difference:.2e}")


if __name__ == "__main__":
    main()

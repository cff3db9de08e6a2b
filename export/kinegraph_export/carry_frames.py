"""Carry skeleton space over to a bundle from another one whose graph encoder and normalisation are the same.

    python -m kinegraph_export.carry_frames --bundle BUNDLE --source BUNDLE

For a bundle whose latent denoisers were trained on with `train_denoisers --keep-graph-encoder`: what the network of
skeleton space reads is then as it was. No other file of the bundle is changed.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from kinegraph.bundle.contract import FRAME_FILES, FRAMES
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.reader import Bundle, read_bundle
from kinegraph.errors import InvalidInputError
from kinegraph.graph import ROLES
from kinegraph_export.bundle_changes import unchanged_if_it_fails, with_graphs, write_files
from kinegraph_export.parity import RANDOM_INPUTS

TEXT_FILES = ("text_encoder.onnx", "tokenizer.json")
MOST_DIFFERENCE = 1e-3
"""Root mean square of the difference between the nodes of two graph encoders that count as one, over that of nodes."""


def draw_graphs(rng: np.random.Generator, width: int) -> dict[str, NDArray[Any]]:
    """Draw two graphs of six nodes at random, the second of them padded: the inputs of a graph encoder."""
    mask = np.ones((2, 6), np.float32)
    mask[1, 4:] = 0
    return {
        "nodes": rng.normal(size=(2, 6, width)).astype(np.float32) * mask[:, :, None],
        "relation": rng.integers(-1, len(ROLES), (2, 6, 6)),
        "edge_weight": rng.uniform(0, 2, (2, 6, 6)).astype(np.float32),
        "node_mask": mask,
    }


def nodes_difference(ours: Bundle, theirs: Bundle) -> float:
    """Measure how far attended nodes of random graphs differ between two bundles, relative to their own size."""
    rng = np.random.Generator(np.random.PCG64(0))
    graphs = [draw_graphs(rng, theirs.manifest.text.width) for _ in range(RANDOM_INPUTS)]
    a, b = (
        np.stack([session.run(["nodes_out"], graph)[0] for graph in graphs])
        for session in (
            onnxruntime.InferenceSession(bundle.read_graph("graph_encoder.onnx"), providers=["CPUExecutionProvider"])
            for bundle in (ours, theirs)
        )
    )
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def find_other(ours: Manifest, theirs: Manifest) -> str | None:
    """Name what two bundles must share for one network of skeleton space, and do not; None where they share all."""
    same = {
        "text encoder": all(ours.files.get(name) == theirs.files.get(name) for name in TEXT_FILES),
        "size of nodes": ours.text == theirs.text,
        "normalisation of features": ours.features == theirs.features,
        "skeleton": (ours.skeleton, ours.fps) == (theirs.skeleton, theirs.fps),
    }
    return next((name for name, shared in same.items() if not shared), None)


def carry_frames(folder: Path, source: Path) -> dict[str, float]:
    """Copy skeleton space into a bundle's folder, and write its manifest anew; returns the parity of what is copied.

    Args:
        folder: of the bundle, changed in place; what it had of skeleton space is replaced.
        source: folder of the bundle that has it.

    Raises:
        BundleError: one of the bundles cannot be read.
        InvalidInputError: the source has no skeleton space, or another graph encoder, text encoder or normalisation.
    """
    bundle, other = read_bundle(folder), read_bundle(source)
    if other.manifest.frames_part is None:
        raise InvalidInputError(f"{source} has no skeleton space; train one: python -m kinegraph_training.train_frames")
    if what := find_other(bundle.manifest, other.manifest):
        raise InvalidInputError(f"{folder} has another {what} than {source}; train a network of skeleton space for it")
    difference = nodes_difference(bundle, other)
    if not difference <= MOST_DIFFERENCE:
        raise InvalidInputError(
            f"the graph encoders of {folder} and {source} differ by {difference:.2g} of a node; train the denoisers "
            "with --keep-graph-encoder, or another network of skeleton space"
        )
    files = frame_files(other)
    of_frames = (f"{FRAMES}_", f"int8_{FRAMES}_")
    parity = {name: value for name, value in other.manifest.parity.items() if name.startswith(of_frames)}
    manifest = with_graphs(bundle.manifest, files, parity, frames_part=other.manifest.frames_part)
    with unchanged_if_it_fails(folder, FRAME_FILES):
        write_files(folder, manifest, files)
        read_bundle(folder)
    return parity


def frame_files(bundle: Bundle) -> dict[str, bytes]:
    """Read the files of skeleton space as they lie there, without the weights that they share."""
    return {name: bundle.read_later(name) for name in sorted(FRAME_FILES)}


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.carry_frames", description=__doc__.split("\n")[0])
    parser.add_argument("--bundle", type=Path, required=True, help="folder of the bundle, changed in place")
    parser.add_argument("--source", type=Path, required=True, help="folder of the bundle that has skeleton space")
    options = parser.parse_args(argv)
    for name, difference in carry_frames(options.bundle, options.source).items():
        print(f"{name:24s} {difference:.2e}")


if __name__ == "__main__":
    main()

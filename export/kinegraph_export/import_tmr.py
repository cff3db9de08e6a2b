"""Turn TMR (Petrovich et al., ICCV 2023) into ONNX, to score clips by how near they are to their sentences.

    python -m kinegraph_export.import_tmr --checkpoint models/tmr_humanml3d_guoh3dfeats \
        --stats stats/humanml3d/guoh3dfeats --distilbert distilbert-base-uncased --out tmr

The checkpoint is the folder of the published model, its `last_weights`, or the trainer's `last.ckpt`; the statistics
are `mean.pt` and `std.pt` of TMR's own repository; `distilbert-base-uncased` is a folder of Hugging Face's. Nothing is
downloaded, and no code of these files is run.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor

from kinegraph.bundle.contract import INT, GraphContract, TensorSpec
from kinegraph.errors import InvalidInputError, KinegraphError
from kinegraph.files import write_atomically
from kinegraph_export.official.distilbert import DistilBert, load_distilbert, read_tokenizer
from kinegraph_export.official.tmr import (
    FEATURES,
    MOTION,
    RELEASED,
    TEXT,
    MotionEmbedding,
    TextEmbedding,
    build_encoder,
    without_tables,
)
from kinegraph_export.onnx_export import serialise, to_onnx
from kinegraph_export.parity import InputGenerator, max_difference
from kinegraph_export.tensor_files import LOAD_ERRORS, load_weights, read_tensors

HEADS: Final = 4
"""Of the released models."""
WEIGHTS: Final = "last_weights"
"""Folder that TMR splits a checkpoint into."""
STATISTICS: Final = ("mean", "std")
FREE: Final = torch.export.Dim.DYNAMIC


def read_encoders(checkpoint: Path) -> dict[str, Tensor]:
    """Read the tensors of both encoders, under the names that they have in one checkpoint.

    Args:
        checkpoint: the trainer's file; or a folder with a file for each part, or with `last_weights`.

    Raises:
        InvalidInputError: see `tensor_files.read_tensors`.
    """
    if not checkpoint.is_dir():
        return without_tables(read_tensors(checkpoint, (MOTION, TEXT)))
    folder = checkpoint / WEIGHTS if (checkpoint / WEIGHTS).is_dir() else checkpoint
    tensors = {part: read_tensors(folder / f"{part}.pt") for part in (MOTION, TEXT)}
    return without_tables(
        {f"{part}.{name}": value for part, all_of in tensors.items() for name, value in all_of.items()}
    )


def read_statistics(folder: Path) -> tuple[Tensor, Tensor]:
    """Read the mean and standard deviation of TMR's features, (263,) each.

    Raises:
        InvalidInputError: a file is missing, or holds something else.
    """
    found = []
    for name in STATISTICS:
        path = folder / f"{name}.pt"
        try:
            value = torch.load(path, map_location="cpu", weights_only=True)
        except (OSError, *LOAD_ERRORS) as error:
            raise InvalidInputError(
                f"{path} cannot be read ({str(error).splitlines()[0]}); --stats names the folder of mean.pt and std.pt "
                "in TMR's repository, stats/humanml3d/guoh3dfeats"
            ) from error
        if not isinstance(value, Tensor) or value.shape != (FEATURES,) or not torch.isfinite(value).all():
            raise InvalidInputError(f"{path} does not hold {FEATURES} finite numbers: it is of other features")
        found.append(value.float())
    if not (found[1] > 0).all():
        raise InvalidInputError(f"{folder / 'std.pt'} holds deviations that are not positive; it is damaged")
    return found[0], found[1]


def load_tmr(checkpoint: Path, stats: Path, words: DistilBert, heads: int) -> tuple[MotionEmbedding, TextEmbedding]:
    """Load both encoders, every name of the checkpoint accounted for.

    Raises:
        InvalidInputError: the checkpoint is of another model or of other features, or a file cannot be read.
    """
    tensors = read_encoders(checkpoint)
    motion, text = build_encoder(tensors, MOTION, heads), build_encoder(tensors, TEXT, heads)
    if motion.config.features != FEATURES:
        raise InvalidInputError(
            f"this TMR has {motion.config.features} features and not the {FEATURES} of HumanML3D; bring {RELEASED}"
        )
    if text.config.features != words.config.width:
        raise InvalidInputError(
            f"this TMR reads states {text.config.features} wide, and --distilbert is {words.config.width} wide; "
            "distilbert-base-uncased is 768 wide"
        )
    if motion.config.width != text.config.width:
        raise InvalidInputError(
            f"the encoders are {motion.config.width} and {text.config.width} wide: they are of different models"
        )
    load_weights({f"{MOTION}.": motion, f"{TEXT}.": text}, tensors, "TMR")
    return MotionEmbedding(motion, *read_statistics(stats)).eval(), TextEmbedding(words, text).eval()


def export_motion(module: MotionEmbedding) -> tuple[bytes, float]:
    """Export the motion encoder; returns ONNX and how far it is from the module."""
    contract = GraphContract(
        "motion",
        (TensorSpec("features", ("B", "L", FEATURES)), TensorSpec("lengths", ("B",), INT)),
        (TensorSpec("vector", ("B", module.encoder.config.width)),),
    )

    def draw(rng: np.random.Generator) -> dict[str, np.ndarray]:
        lengths = rng.integers(4, 200, int(rng.integers(1, 4)))
        features = rng.standard_normal((len(lengths), int(lengths.max()), FEATURES)).astype(np.float32)
        return {"features": features * module.deviation.numpy() + module.mean.numpy(), "lengths": lengths}

    example = (torch.zeros(2, 12, FEATURES), torch.tensor([12, 8]))
    graph = to_onnx(module, example, ["features", "lengths"], ["vector"], ({0: FREE, 1: FREE}, {0: FREE}))
    data = serialise(graph)
    return data, max_difference(data, module, contract, draw)


def export_text(module: TextEmbedding) -> tuple[bytes, float]:
    """Export DistilBERT and the text encoder as one graph; returns ONNX and how far it is from the module."""
    names = ("input_ids", "attention_mask")
    contract = GraphContract(
        "text",
        tuple(TensorSpec(name, ("B", "T"), INT) for name in names),
        (TensorSpec("vector", ("B", module.encoder.config.width)),),
    )
    data = serialise(
        to_onnx(
            module,
            (torch.tensor([[1, 2, 3, 4], [1, 2, 3, 0]]), torch.tensor([[1, 1, 1, 1], [1, 1, 1, 0]])),
            names,
            ["vector"],
            ({0: FREE, 1: FREE},) * 2,
        )
    )
    return data, max_difference(data, module, contract, draw_captions(module.words))


def draw_captions(words: DistilBert) -> InputGenerator:
    """Make a generator of random word pieces of several lengths."""

    def draw(rng: np.random.Generator) -> dict[str, np.ndarray]:
        lengths = rng.integers(3, min(30, words.config.positions), int(rng.integers(1, 4)))
        ids = rng.integers(0, words.config.vocabulary, (len(lengths), int(lengths.max())))
        return {"input_ids": ids, "attention_mask": (np.arange(ids.shape[1]) < lengths[:, None]).astype(np.int64)}

    return draw


def import_tmr(checkpoint: Path, stats: Path, distilbert: Path, out: Path, *, heads: int = HEADS) -> dict[str, float]:
    """Write motion.onnx, text.onnx and tokenizer.json.

    Args:
        checkpoint: see `read_encoders`.
        stats: folder of mean.pt and std.pt.
        distilbert: folder of Hugging Face's files.
        out: folder to write.
        heads: of every layer of TMR.

    Returns:
        Largest difference of each graph to its torch module.

    Raises:
        InvalidInputError: a file cannot be used; says which, and what to do.
    """
    words = load_distilbert(distilbert)
    tokenizer = read_tokenizer(distilbert, words.config.vocabulary)
    motion, text = load_tmr(checkpoint, stats, words, heads)
    (motion_graph, motion_parity), (text_graph, text_parity) = export_motion(motion), export_text(text)
    out.mkdir(parents=True, exist_ok=True)
    for name, data in (("motion.onnx", motion_graph), ("text.onnx", text_graph), ("tokenizer.json", tokenizer)):
        write_atomically(out / name, data)
    return {"motion": motion_parity, "text": text_parity}


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.import_tmr", description=__doc__.split("\n")[0])
    parser.add_argument("--checkpoint", type=Path, required=True, help="folder of the published model, or last.ckpt")
    parser.add_argument("--stats", type=Path, required=True, help="folder of TMR's mean.pt and std.pt")
    parser.add_argument("--distilbert", type=Path, required=True, help="folder of distilbert-base-uncased")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--heads", type=int, default=HEADS, help=f"of every layer ({HEADS})")
    options = parser.parse_args(argv)
    try:
        parity = import_tmr(options.checkpoint, options.stats, options.distilbert, options.out, heads=options.heads)
    except KinegraphError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    for name, difference in parity.items():
        size = (options.out / f"{name}.onnx").stat().st_size
        print(f"{size / 1e6:8.2f} MB  {options.out / name}.onnx, within {difference:.1e} of torch")
    return 0


if __name__ == "__main__":
    sys.exit(main())

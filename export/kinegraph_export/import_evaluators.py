"""Turn the evaluators of Guo et al. (2022) into ONNX, so that measuring in the papers' way needs no torch.

    python -m kinegraph_export.import_evaluators --checkpoint t2m/text_mot_match/model/finest.tar --out evaluators

`finest.tar` is a checkpoint, not an archive. Those of GraphMotion and MLD hold the same networks.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from kinegraph.errors import KinegraphError
from kinegraph_export.official.evaluators import BUILDERS, PARTS, evaluator_weights
from kinegraph_export.tensor_files import read_tensors


def import_evaluators(checkpoint: Path, out: Path) -> dict[str, int]:
    """Write movement.onnx, motion.onnx and text.onnx.

    Args:
        checkpoint: file with the evaluators' weights.
        out: folder to write.

    Returns:
        Bytes by file name.

    Raises:
        InvalidInputError: the file cannot be read, or has no evaluators.
    """
    tensors = read_tensors(checkpoint, [name for names in PARTS.values() for name in names])
    files = {f"{part}.onnx": build(evaluator_weights(tensors, part)) for part, build in BUILDERS.items()}
    out.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        (out / name).write_bytes(data)
    return {name: len(data) for name, data in files.items()}


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.import_evaluators", description=__doc__.split("\n")[0])
    parser.add_argument("--checkpoint", type=Path, required=True, help="finest.tar, or a checkpoint of GraphMotion")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    options = parser.parse_args(argv)
    try:
        sizes = import_evaluators(options.checkpoint, options.out)
    except KinegraphError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    for name, size in sizes.items():
        print(f"{size / 1e6:8.2f} MB  {options.out / name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

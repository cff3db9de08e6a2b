"""Export a trained evaluator as two ONNX graphs and a card, so that measuring needs no torch and stays comparable.

python -m kinegraph_export.export_evaluator --run runs/evaluator --version 3 --licence "CC0" --out EVALUATOR
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import nn

from kinegraph.errors import InvalidInputError
from kinegraph_export.onnx_export import round_weights, serialise, store_float16, to_onnx
from kinegraph_export.parity import ParityError
from kinegraph_training.checkpoints import read_checkpoint
from kinegraph_training.models.evaluator import EvaluatorConfig, MotionEncoder, TextEncoder

TOLERANCE = 1e-4
"""Largest difference between an exported encoder and its module."""


def read_evaluator(run: Path) -> tuple[MotionEncoder, TextEncoder, np.ndarray, np.ndarray]:
    """Load the averaged weights of a run of train_evaluator.

    Returns:
        Motion encoder, text encoder, and mean and standard deviation (features,) of motion features.

    Raises:
        InvalidInputError: it has not been trained.
    """
    path = run / "last.ckpt"
    if not path.is_file():
        raise InvalidInputError(f"{path} is missing; train the evaluator first (kinegraph_training.train_evaluator)")
    state = read_checkpoint(path)
    config = EvaluatorConfig(**state["hyper_parameters"]["config"])
    encoders = nn.ModuleDict({"motion": MotionEncoder(config), "text": TextEncoder(config)})
    weights, prefix = state["state_dict"], "encoders."
    encoders.load_state_dict({k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)})
    round_weights(encoders.eval())
    return encoders["motion"], encoders["text"], weights["mean"].numpy(), weights["std"].numpy()  # type: ignore[return-value]


def export_encoder(module: nn.Module, width: int, group: int) -> bytes:
    """Export one encoder with inputs "tokens" (b, s, width) and "mask" (b, s), and output "embedding" (b, e).

    Args:
        module: takes tokens and mask.
        width: of a token.
        group: frames per token, which s is a multiple of.

    Raises:
        ParityError: at one of six shapes it differs from the module.
    """
    free = {0: torch.export.Dim.DYNAMIC, 1: torch.export.Dim.DYNAMIC}
    if group > 1:
        free[1] = group * torch.export.Dim("groups", min=1, max=512)  # type: ignore[assignment]
    example = (torch.zeros(2, 6 * group, width), torch.ones(2, 6 * group))
    data = serialise(store_float16(to_onnx(module, example, ["tokens", "mask"], ["embedding"], (free, free))))
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(0)
    for _ in range(6):
        batch, length = int(rng.integers(1, 9)), group * int(rng.integers(1, 30))
        tokens = rng.standard_normal((batch, length, width), dtype=np.float32)
        mask = (np.arange(length) < rng.integers(1, length + 1, batch)[:, None]).astype(np.float32)
        with torch.no_grad():
            expected = module(torch.from_numpy(tokens), torch.from_numpy(mask)).numpy()
        difference = np.abs(session.run(["embedding"], {"tokens": tokens, "mask": mask})[0] - expected).max()
        if not difference <= TOLERANCE:
            raise ParityError(f"the exported encoder differs by {difference:.2e} at {tokens.shape}")
    return data


def export_evaluator(run: Path, version: str, licence: str, out: Path) -> None:
    """Export a run as motion.onnx, text.onnx and evaluator.json.

    Args:
        run: folder of the training run.
        version: scores compare within one version only.
        licence: terms of the weights, which follow from those of the training data.
        out: folder to write.
    """
    motion, text, mean, std = read_evaluator(run)
    files = {
        "motion.onnx": export_encoder(motion, len(mean), motion.group),
        "text.onnx": export_encoder(text, text.token_in.in_features, 1),
    }
    with (run / "curves" / "metrics.csv").open(newline="") as file:
        scores = {k: float(v) for row in csv.DictReader(file) for k, v in row.items() if k.startswith("val/") and v}
    card = {
        "version": version,
        "licence": licence,
        "trained_on": "train split, recorded clips and their mirror images, no compositions",
        "validation": scores,
        "frames_per_token": motion.group,
        "mean": mean.tolist(),
        "std": std.tolist(),
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in files.items()},
    }
    out.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        (out / name).write_bytes(data)
    (out / "evaluator.json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.export_evaluator", description=__doc__.split("\n")[0])
    parser.add_argument("--run", type=Path, required=True, help="folder of the training run")
    parser.add_argument("--version", required=True, help="of the evaluator: scores compare within one version only")
    parser.add_argument("--licence", required=True, help="terms of the weights, after those of the training data")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    options = parser.parse_args(argv)
    export_evaluator(options.run, options.version, options.licence, options.out)
    size = sum(path.stat().st_size for path in options.out.iterdir())
    print(f"evaluator {options.version}: {size / 1e6:.1f} MB in {options.out}")


if __name__ == "__main__":
    main()

"""Measure what the autoencoders keep of captured motion, per level (GraphMotion, Table D).

    python -m kinegraph_benchmarks.quality.reconstruction --data DATA/bandai --run runs/edge --out reconstruction.json

Recognition and clean movement are measured besides. There is no diffusion here: nothing generated can be better than
this. Writes JSON, and a Markdown table beside it.
"""

from __future__ import annotations

import torch

from kinegraph.bundle.contract import LEVELS
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.autoencoder_scores import score_autoencoder
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_benchmarks.common.label_classifier import LabelClassifier
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.sample_cache import long_enough
from kinegraph_training.data.clips import read_split
from kinegraph_training.latents import read_vae

SPLITS = ("val", "dev_test", "dev_compositional")


def markdown_table(result: dict[str, dict[str, dict[str, float]]]) -> str:
    """Format a result (split -> level -> metric) as Markdown."""
    names = list(result[SPLITS[0]][LEVELS[0]])
    lines = ["| split | level | " + " | ".join(names) + " |", "|---|---|" + "---|" * len(names)]
    for split, levels in result.items():
        for level, scores in levels.items():
            lines.append(f"| {split} | {level} | " + " | ".join(f"{scores[name]:.3g}" for name in names) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the command line."""
    parser = benchmark_parser(__doc__)
    add_arguments(parser, "data", "run", "out")
    options = parser.parse_args()
    # Clips are encoded one by one: more threads only wait for one another, for minutes beside a busy core.
    torch.set_num_threads(1)
    evaluator, classifier = Evaluator(), LabelClassifier(read_split(options.data, "train"))
    vaes = {level: read_vae(options.run / f"vae_{level}" / "last.ckpt") for level in LEVELS}
    result = {}
    for split in SPLITS:
        clips = long_enough(read_split(options.data, split))
        result[split] = {level: score_autoencoder(vae, clips, evaluator, classifier) for level, vae in vaes.items()}
    write_report(options.out, result, markdown_table(result))


if __name__ == "__main__":
    main()

"""Turn the published checkpoint of MLD (Chen et al., CVPR 2023) into a bundle of one level.

    python -m kinegraph_export.import_mld --checkpoint 1222_mld_humanml3d_FID041.ckpt --clip clip-vit-large-patch14 \
        --stats HumanML3D --out mld

It sees the sentence as a whole: edges and nodes of a graph change nothing but the caption.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from kinegraph.bundle.manifest import Manifest
from kinegraph_export.clip_text_encoder import export_clip, load_clip
from kinegraph_export.graphs import Precision
from kinegraph_export.official.bundle import Origin, check_sizes, check_target, read_parser, write_imported
from kinegraph_export.official.checkpoint import VAE_HEADS, mld_models
from kinegraph_export.official.command import add_arguments, run_import
from kinegraph_export.official.statistics import read_statistics
from kinegraph_export.tensor_files import read_tensors


def import_mld(
    checkpoint: Path,
    clip: Path,
    stats: Path,
    out: Path,
    *,
    precision: Precision = "int8",
    parser: Path | None = None,
    heads: int = VAE_HEADS,
) -> Manifest:
    """Import a checkpoint; see `import_graphmotion`."""
    check_target(out)
    parser_files = read_parser(parser)
    models = mld_models(read_tensors(checkpoint), heads=heads)
    features = models.vae.config.features
    statistics = read_statistics(stats, features)
    tower = load_clip(clip)
    check_sizes(models.denoiser.config.text_width, features, tower.config.width)
    assets = export_clip(tower, clip, precision=precision)
    origin = Origin("mld", "MLD (Chen et al., 2023), released networks", "MIT", checkpoint)
    return write_imported(out, origin, models, "mld", assets, statistics, parser_files, precision)


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.import_mld", description=__doc__.split("\n")[0])
    add_arguments(parser)
    parser.add_argument("--heads", type=int, default=VAE_HEADS, help="attention heads")
    options = parser.parse_args(argv)
    return run_import(
        lambda: import_mld(
            options.checkpoint,
            options.clip,
            options.stats,
            options.out,
            precision=options.precision,
            parser=options.parser,
            heads=options.heads,
        ),
        options.out,
    )


if __name__ == "__main__":
    sys.exit(main())

"""Turn the published checkpoint of GraphMotion (Jin et al., NeurIPS 2023) into a bundle.

    python -m kinegraph_export.import_graphmotion --checkpoint GraphMotion.ckpt --clip clip-vit-large-patch14 \
        --stats HumanML3D --out graphmotion

Then `kinegraph generate --bundle graphmotion "a person walks in a circle"` runs it without torch. The files are the
user's own downloads; nothing is fetched, and no code of a checkpoint is run.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from kinegraph.bundle.contract import LEVELS, Family
from kinegraph.bundle.manifest import Manifest
from kinegraph_export.clip_text_encoder import export_clip, load_clip
from kinegraph_export.graphs import Precision
from kinegraph_export.official.bundle import Origin, check_sizes, check_target, read_parser, write_imported
from kinegraph_export.official.checkpoint import DENOISER_HEADS, VAE_HEADS, graphmotion_models
from kinegraph_export.official.command import add_arguments, run_import
from kinegraph_export.official.statistics import read_statistics
from kinegraph_export.tensor_files import read_tensors

COMPATIBILITY: dict[str, Family] = {"released": "graphmotion-released", "trained": "graphmotion"}
"""Choice on the command line -> family of the bundle, see `contract.Family`."""


def import_graphmotion(
    checkpoint: Path,
    clip: Path,
    stats: Path,
    out: Path,
    *,
    precision: Precision = "int8",
    compatibility: str = "released",
    parser: Path | None = None,
    heads: tuple[int, int] = (VAE_HEADS, DENOISER_HEADS),
) -> Manifest:
    """Import a checkpoint.

    Args:
        checkpoint: file with the weights of all stages.
        clip: folder of the text encoder, as Hugging Face has it.
        stats: folder with Mean.npy and Std.npy of the data set: HumanML3D, or KIT-ML.
        out: folder of the bundle.
        precision: of denoisers and text encoder.
        compatibility: "released" runs sentences as the released evaluation does, "trained" as its training does.
        parser: bundle whose sentence parser is taken; None is the default bundle.
        heads: of the autoencoders and of the denoisers, which a checkpoint does not tell.

    Raises:
        InvalidInputError: a file is missing, of another model, version or data set; says which and what to do.
        OutputError: `out` is a folder of something else.
        ParityError: a graph differs from its module.
    """
    check_target(out)
    parser_files = read_parser(parser)
    tensors = read_tensors(checkpoint)
    models = graphmotion_models(tensors, vae_heads=heads[0], denoiser_heads=heads[1])
    finest = LEVELS[-1]
    features, text_width = models.vaes[finest].config.features, models.denoisers[finest].config.text_width
    statistics = read_statistics(stats, features)
    tower = load_clip(clip)
    check_sizes(text_width, features, tower.config.width)
    assets = export_clip(tower, clip, precision=precision)
    origin = Origin("graphmotion", "GraphMotion (Jin et al., 2023), released networks", "Apache-2.0", checkpoint)
    family = COMPATIBILITY[compatibility]
    return write_imported(out, origin, models, family, assets, statistics, parser_files, precision)


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.import_graphmotion", description=__doc__.split("\n")[0])
    add_arguments(parser)
    parser.add_argument(
        "--compatibility",
        choices=list(COMPATIBILITY),
        default="released",
        help="run sentences as the released evaluation does (published figures), or as its training does",
    )
    parser.add_argument("--vae-heads", type=int, default=VAE_HEADS, help="attention heads of the autoencoders")
    parser.add_argument("--denoiser-heads", type=int, default=DENOISER_HEADS, help="attention heads of the denoisers")
    options = parser.parse_args(argv)
    return run_import(
        lambda: import_graphmotion(
            options.checkpoint,
            options.clip,
            options.stats,
            options.out,
            precision=options.precision,
            compatibility=options.compatibility,
            parser=options.parser,
            heads=(options.vae_heads, options.denoiser_heads),
        ),
        options.out,
    )


if __name__ == "__main__":
    sys.exit(main())

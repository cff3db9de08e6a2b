"""Give a bundle the words and the sampling of a card, and keep its networks.

    python -m kinegraph_export.apply_card --bundle runtime/kinegraph/bundles/studio --card export/studio_card.json \
        --run runs/recovered

The run is what the bundle was exported from, or what `kinegraph_export.recover` makes of the bundle: whole clips are
compared with it by the new sampling.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from kinegraph.bundle.manifest import Defaults, Manifest
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.verify import verify_bundle
from kinegraph_export.bundle_changes import unchanged_if_it_fails, write_files
from kinegraph_export.checkpoints import read_run
from kinegraph_export.export_bundle import BundleCard, pipeline_parity
from kinegraph_training.bundle_tables import read_tables


def with_card(manifest: Manifest, card: BundleCard) -> Manifest:
    """Replace what a person wrote in a manifest by what stands in a card."""
    return dataclasses.replace(
        manifest,
        name=card.name,
        version=card.version,
        licence=card.licence,
        provenance={**manifest.provenance, "training_data": card.training_data},
        scope=card.scope,
        schedule=dataclasses.replace(manifest.schedule, spacing=card.spacing),
        defaults=Defaults(card.steps, card.guidance, card.guidance_base, card.seconds),
        training=card.training,
        quality=card.quality,
    )


def apply_card(folder: Path, run: Path, card: BundleCard) -> dict[str, float]:
    """Write the manifest of a bundle anew by a card; returns how far its clips are from torch, mm.

    Args:
        folder: of the bundle, changed in place.
        run: folder of the training run.
        card: what a person wrote.

    Raises:
        BundleError: the bundle cannot be read, or would not be with the card; it is left as it was.
        InvalidInputError: a stage of the run is missing.
        ParityError: clips differ from torch; the bundle is left as it was.
    """
    changed = with_card(read_bundle(folder).manifest, card)
    trained, specific = read_run(run)
    with unchanged_if_it_fails(folder, ()):
        write_files(folder, changed)
        verify_bundle(folder)
        parity = pipeline_parity(folder, trained, specific, read_tables(run), changed.precision)
        write_files(folder, dataclasses.replace(changed, parity={**changed.parity, **parity}))
    return parity


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.apply_card", description=__doc__.split("\n")[0])
    parser.add_argument("--bundle", type=Path, required=True, help="folder of the bundle, changed in place")
    parser.add_argument("--card", type=Path, required=True, help="JSON: name, version, licences, defaults, quality")
    parser.add_argument("--run", type=Path, required=True, help="folder of the training run")
    options = parser.parse_args(argv)
    for name, distance in apply_card(options.bundle, options.run, BundleCard.read(options.card)).items():
        print(f"{name:20s} {distance:.2e}")


if __name__ == "__main__":
    main()

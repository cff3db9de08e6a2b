"""Load the trained modules of a run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from kinegraph.bundle.contract import COARSE_DECODERS
from kinegraph.bundle.manifest import Manifest
from kinegraph.errors import InvalidInputError
from kinegraph_export.graphs import CoarseDecoder, TrainedModels
from kinegraph_export.onnx_export import round_weights
from kinegraph_training.checkpoints import read_checkpoint
from kinegraph_training.latents import TrainedVae, read_vae
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy


def read_run(run: Path) -> tuple[TrainedModels, TrainedVae]:
    """Load the averaged weights of the autoencoders and the denoisers, rounded to what a bundle holds.

    Args:
        run: folder with denoisers/last.ckpt and vae_{level}/last.ckpt.

    Returns:
        The models, and the specific autoencoder with the statistics of its features.

    Raises:
        InvalidInputError: a stage has not been trained.
    """
    denoisers, vae = run / "denoisers" / "last.ckpt", run / "vae_specific" / "last.ckpt"
    for path in (denoisers, vae):
        if not path.is_file():
            raise InvalidInputError(f"{path} is missing; train that stage first")
    state = read_checkpoint(denoisers)
    settings = state["hyper_parameters"]
    latents = {level: LatentShape(**shape) for level, shape in settings["latents"].items()}
    hierarchy = Hierarchy(DenoiserConfig(**settings["config"]), latents)
    weights = state["state_dict"]
    prefix = "hierarchy."
    hierarchy.load_state_dict({k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)})
    specific = read_vae(vae)
    coarse = {
        level: load_coarse_decoder(run, level, weights, specific)
        for level in COARSE_DECODERS
        if f"{level}_centre" in weights
    }
    for module in (hierarchy, specific.vae, *(decoder.vae for decoder in coarse.values())):
        round_weights(module.eval())
    models = TrainedModels(hierarchy, specific.vae, weights["specific_centre"], weights["specific_scale"], coarse)
    return models, specific


def check_normalisation(checkpoint: Path, manifest: Manifest) -> None:
    """Refuse an autoencoder that does not normalise features as a bundle does: it is of another bundle.

    Raises:
        InvalidInputError: there is no such checkpoint, or its normalisation is another.
    """
    if not checkpoint.is_file():
        raise InvalidInputError(f"{checkpoint} is missing; train it, or recover a run from a bundle")
    weights = read_checkpoint(checkpoint)["state_dict"]
    for name, of_bundle in (("mean", manifest.features.mean), ("std", manifest.features.std)):
        ours = weights[name].numpy()
        if ours.shape != (len(of_bundle),) or not np.allclose(ours, of_bundle, rtol=1e-4, atol=1e-6):
            raise InvalidInputError(
                f"{checkpoint} normalises features by another {name} than the bundle {manifest.name}: it is of another "
                "bundle"
            )


def load_coarse_decoder(
    run: Path, level: str, weights: Mapping[str, torch.Tensor], specific: TrainedVae
) -> CoarseDecoder:
    """Load the decoder of a coarser level, with the map from its normalised features to those of the specific level."""
    trained = read_vae(run / f"vae_{level}" / "last.ckpt")
    # x = std z + mean on both sides: z_specific = z_level (std_l / std_s) + (mean_l - mean_s) / std_s
    gain, shift = (
        torch.from_numpy(part) for part in (trained.std / specific.std, (trained.mean - specific.mean) / specific.std)
    )
    return CoarseDecoder(trained.vae, weights[f"{level}_centre"], weights[f"{level}_scale"], gain, shift)

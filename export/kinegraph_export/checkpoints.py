"""Trained modules read back from a run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch

from kinegraph.bundle.contract import COARSE_DECODERS
from kinegraph.errors import InvalidInputError
from kinegraph_export.graphs import CoarseDecoder, Trained
from kinegraph_export.onnx_export import round_weights
from kinegraph_training.latents import TrainedVae, read_vae
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy


def read_run(run: Path) -> tuple[Trained, TrainedVae]:
    """Averaged weights of the specific autoencoder and of the denoisers, rounded to what a bundle holds.

    Raises:
        InvalidInputError: a stage has not been trained.
    """
    denoisers, vae = run / "denoisers" / "last.ckpt", run / "vae_specific" / "last.ckpt"
    for path in (denoisers, vae):
        if not path.is_file():
            raise InvalidInputError(f"{path} is missing; train that stage first")
    state = torch.load(denoisers, map_location="cpu", weights_only=True)
    known = state["hyper_parameters"]
    latents = {level: LatentShape(**shape) for level, shape in known["latents"].items()}
    hierarchy = Hierarchy(DenoiserConfig(**known["config"]), latents)
    weights = state["state_dict"]
    prefix = "hierarchy."
    hierarchy.load_state_dict({k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)})
    own = read_vae(vae)
    coarse = {
        level: coarse_decoder(run, level, weights, own) for level in COARSE_DECODERS if f"{level}_centre" in weights
    }
    for module in (hierarchy, own.vae, *(each.vae for each in coarse.values())):
        round_weights(module.eval())
    return Trained(hierarchy, own.vae, weights["specific_centre"], weights["specific_scale"], coarse), own


def coarse_decoder(run: Path, level: str, weights: Mapping[str, torch.Tensor], own: TrainedVae) -> CoarseDecoder:
    """A coarser level's decoder, its features normalised as those of `own`, the specific level's."""
    found = read_vae(run / f"vae_{level}" / "last.ckpt")
    gain, shift = (torch.from_numpy(part) for part in (found.std / own.std, (found.mean - own.mean) / own.std))
    return CoarseDecoder(found.vae, weights[f"{level}_centre"], weights[f"{level}_scale"], gain, shift)

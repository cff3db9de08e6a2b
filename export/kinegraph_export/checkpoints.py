"""Trained modules read back from a run's folder."""

from __future__ import annotations

from pathlib import Path

import torch

from kinegraph.errors import InvalidInputError
from kinegraph_export.graphs import Trained
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
    for module in (hierarchy, own.vae):
        round_weights(module.eval())
    return Trained(hierarchy, own.vae, weights["specific_centre"], weights["specific_scale"]), own

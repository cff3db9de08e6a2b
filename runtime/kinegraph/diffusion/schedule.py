"""Noise schedule of latent diffusion (Rombach et al.'s "scaled linear" betas, as MLD and GraphMotion use them)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import InvalidInputError


@dataclass(frozen=True)
class NoiseSchedule:
    """betas = linspace(sqrt(beta_start), sqrt(beta_end), train_steps)^2; alpha_bar_t = prod_s<=t (1 - beta_s)."""

    train_steps: int = 1000
    beta_start: float = 8.5e-4
    beta_end: float = 0.012
    steps_offset: int = 1
    """Added to every timestep of `leading` spacing."""
    spacing: Literal["leading", "trailing"] = "leading"
    """`leading` counts up from the clean end (the published models); `trailing` starts at pure noise, which is
    fairer when steps are few."""

    def __post_init__(self) -> None:
        if self.train_steps < 1 or not 0 < self.beta_start <= self.beta_end < 1:
            raise InvalidInputError(
                f"a schedule needs train_steps >= 1 and 0 < beta_start <= beta_end < 1, not {self.train_steps}, "
                f"{self.beta_start}, {self.beta_end}"
            )
        if self.spacing not in ("leading", "trailing"):
            raise InvalidInputError(f"spacing must be 'leading' or 'trailing', not {self.spacing!r}")

    @cached_property
    def alphas_cumprod(self) -> NDArray[np.float64]:
        """alpha_bar, (train_steps,)."""
        betas = np.linspace(self.beta_start**0.5, self.beta_end**0.5, self.train_steps) ** 2
        table = np.cumprod(1.0 - betas).astype(np.float64, copy=False)
        table.setflags(write=False)
        return table

    def timesteps(self, steps: int) -> NDArray[np.int64]:
        """The timesteps of a run of `steps` steps, descending, (steps,).

        Raises:
            InvalidInputError: fewer than one step, or one that falls outside the table.
        """
        if not 1 <= steps <= self.train_steps:
            raise InvalidInputError(f"steps must be 1 to {self.train_steps}, not {steps}")
        if self.spacing == "leading":
            ratio = self.train_steps // steps
            times = np.arange(steps - 1, -1, -1, dtype=np.int64) * ratio + self.steps_offset
        else:
            ratio_exact = self.train_steps / steps
            times = np.round(np.arange(self.train_steps, 0, -ratio_exact)).astype(np.int64)[:steps] - 1
        if times[0] >= self.train_steps:
            raise InvalidInputError(
                f"{steps} steps would start at timestep {times[0]} of a schedule of {self.train_steps}; take fewer"
            )
        return times

"""Integrate noise predictions to the energy whose gradient they are, on a plane of latents.

EnergyMoGen, Eq. 5 and 6: eps(z_t, c, t) = grad_z E(z_t, c).

A denoiser gives the gradient, not the energy. On a grid of a plane, E is the scalar whose differences between
neighbours are nearest to the integral of eps along the edge between them:

    E = argmin sum_edges (E(b) - E(a) - 1/2 (eps(a) + eps(b)) . (b - a))^2,  mean E = 0

Least squares, because a network need not be an exact gradient; `rest` says how far it is from one. E is linear in eps:
the energy of a mixture of predictions is that mixture of their energies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray
from kinegraph.diffusion.sampling import PredictNoise
from kinegraph.errors import NonFiniteError

SAME: Final = 1e-3
"""Closer than this, in standard deviations of the latent, two samples count as equal: the rest is rounding."""


@dataclass(frozen=True)
class EnergyMap:
    """The energy of one way to predict the noise, on a plane of latents."""

    label: str
    energy: DoubleArray
    """(GRID, GRID), least value 0; [i, j] is at `second[i]`, `first[j]`."""
    sample: DoubleArray
    """(2,) where its own sample ends on the plane, from the same noise and the same coarser latents."""
    off_plane: float
    """Distance of the sample from the plane, in the unit of the axes."""
    rest: float
    """Share of the predicted noise on the plane that is no gradient (`diffusion.energy.potential`)."""


@dataclass(frozen=True)
class EnergyMaps:
    """Maps of one composition on one plane through the specific latents.

    The plane goes through the samples of the first two concepts and of the composition. Its place (0, 0) is the
    composition's; the first axis leads from the first concept's sample to the second's, the other one across. The unit
    is one standard deviation of the latent. A place z has the energy, under the guided prediction, of sqrt(alpha_bar)
    z: what z is on average at that timestep.
    """

    maps: tuple[EnergyMap, ...]
    """Of each concept, the composition, the joint text."""
    first: DoubleArray
    """(GRID,) points along the first axis."""
    second: DoubleArray
    """(GRID,) points along the second axis."""
    timestep: int
    """Timestep of the schedule at which the energies are taken."""


@dataclass(frozen=True)
class Plane:
    """A plane of latents (C, z)."""

    origin: DoubleArray
    """(C, z) the latent at (0, 0)."""
    axes: DoubleArray
    """(2, C z) orthonormal."""

    def place(self, latent: DoubleArray) -> DoubleArray:
        """Project a latent (C, z) onto the plane: its coordinates (2,)."""
        coordinates: DoubleArray = self.axes @ (latent - self.origin).ravel()
        return coordinates

    def latent(self, first: float, second: float) -> DoubleArray:
        """Return the latent (C, z) at a point of the plane."""
        latent: DoubleArray = self.origin + (first * self.axes[0] + second * self.axes[1]).reshape(self.origin.shape)
        return latent


def plane_through(samples: Sequence[DoubleArray]) -> Plane:
    """Lay a plane through samples: origin at the first, first axis from the second to the third, second axis across.

    Args:
        samples: two or more latents (C, z). Where they are on one line, or coincide, later ones and then the first
            coordinates stand in.
    """
    first, *others = (sample.ravel() for sample in samples)
    across = others[1] - others[0] if len(others) > 1 else others[0] - first
    axes = np.zeros((0, len(first)))
    for direction in (across, *(first - other for other in others), *np.eye(len(first))):  # Gram-Schmidt
        rest = direction - (axes @ direction) @ axes
        length = float(np.linalg.norm(rest))
        if len(axes) < 2 and length > SAME:
            axes = np.vstack([axes, rest / length])
    return Plane(samples[0], axes)


def noise_field(
    predict: PredictNoise,
    step: int,
    signal: float,
    plane: Plane,
    points: tuple[DoubleArray, DoubleArray],
    after_row: Callable[[], None],
) -> DoubleArray:
    """Compute the gradient of E along both axes, (G, G, 2), at [i, j] = (second axis, first axis).

    A point stands for the latent z there; E is taken at sqrt(alpha_bar) z, the mean of q(z_t | z), so that
    dE/dx = sqrt(alpha_bar) eps(sqrt(alpha_bar) z, t) . axis.

    Args:
        predict: guided noise.
        step: index of the step of a run.
        signal: alpha_bar of its timestep.
        plane: of the latents.
        points: along the first and the second axis, (G,) each.
        after_row: called after every G runs of the model; may raise to stop.

    Raises:
        NonFiniteError: the model produced NaN or infinity.
    """
    root = np.sqrt(signal)
    field = np.empty((len(points[1]), len(points[0]), 2))
    for i, second in enumerate(points[1]):
        for j, first in enumerate(points[0]):
            noise = predict((root * plane.latent(first, second))[None].astype(np.float32), step)
            field[i, j] = root * (plane.axes @ noise.ravel())
        if not np.isfinite(field[i]).all():
            raise NonFiniteError("the predicted noise is not finite; the bundle's weights are broken")
        after_row()
    return field


def edge_integrals(field: DoubleArray, spacing: float) -> DoubleArray:
    """Integrate a field (G, G, 2) along the edges of its grid: those along the first axis, then along the second."""
    across = (field[:, :-1, 0] + field[:, 1:, 0]) / 2
    along = (field[:-1, :, 1] + field[1:, :, 1]) / 2
    return spacing * np.concatenate([across.ravel(), along.ravel()])


def potential(field: DoubleArray, spacing: float) -> tuple[DoubleArray, float]:
    """Solve for the energy whose gradient is nearest to a field, by least squares.

    Args:
        field: (G, G, 2), see `noise_field`.
        spacing: between neighbouring points.

    Returns:
        The energy (G, G) with mean 0, and the share of the field (root of squares) that is no gradient of it.
    """
    size = len(field)
    integrals = edge_integrals(field, spacing)
    step = np.diff(np.eye(size), axis=0)
    differences = np.concatenate([np.kron(np.eye(size), step), np.kron(step, np.eye(size))])
    # the added constant asks for mean 0, which the differences leave open
    energy = np.linalg.solve(differences.T @ differences + 1 / size**2, differences.T @ integrals)
    rest = np.linalg.norm(differences @ energy - integrals) / max(float(np.linalg.norm(integrals)), 1e-12)
    return energy.reshape(size, size), float(rest)

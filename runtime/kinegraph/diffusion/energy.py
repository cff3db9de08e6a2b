"""The energy whose gradient a noise prediction is (EnergyMoGen, Eq. 5, 6: eps(z_t, c, t) = grad_z E(z_t, c)), on a
plane of latents.

A denoiser gives the gradient, not the energy. On a grid of a plane, E is the scalar whose differences between
neighbours are nearest to the integral of eps along the edge between them:

    E = argmin sum_edges (E(b) - E(a) - 1/2 (eps(a) + eps(b)) . (b - a))^2,  mean E = 0

Least squares, because a network need not be an exact gradient; `rest` says how far it is from one. E is linear in eps:
the energy of a mixture of predictions is that mixture of their energies.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray
from kinegraph.diffusion.sampling import Predict
from kinegraph.errors import NonFiniteError

SAME: Final = 1e-3
"""Standard deviations of the latent: samples as near as this are one, and what parts them is rounding."""


@dataclass(frozen=True)
class Plane:
    """A plane of latents (C, z)."""

    origin: DoubleArray
    """(C, z) the latent at (0, 0)."""
    axes: DoubleArray
    """(2, C z) orthonormal."""

    def place(self, latent: DoubleArray) -> DoubleArray:
        """(2,) where a latent (C, z) is, seen along the normal of the plane."""
        place: DoubleArray = self.axes @ (latent - self.origin).ravel()
        return place

    def latent(self, first: float, second: float) -> DoubleArray:
        """(C, z) at a place."""
        latent: DoubleArray = self.origin + (first * self.axes[0] + second * self.axes[1]).reshape(self.origin.shape)
        return latent


def plane_through(samples: Sequence[DoubleArray]) -> Plane:
    """The plane with its origin at the first sample: from the second sample to the third, and across.

    Args:
        samples: two or more latents (C, z). Where they are on one line, or coincide, later ones and then the first
            coordinates stand in.
    """
    first, *others = (each.ravel() for each in samples)
    across = others[1] - others[0] if len(others) > 1 else others[0] - first
    found = np.zeros((0, len(first)))
    for each in (across, *(first - other for other in others), *np.eye(len(first))):
        rest = each - (found @ each) @ found
        length = float(np.linalg.norm(rest))
        if len(found) < 2 and length > SAME:
            found = np.vstack([found, rest / length])
    return Plane(samples[0], found)


def noise_field(
    predict: Predict,
    step: int,
    signal: float,
    plane: Plane,
    places: tuple[DoubleArray, DoubleArray],
    after_row: Callable[[], None],
) -> DoubleArray:
    """The gradient of E along both axes, (G, G, 2); [i, j] is the i-th place of the second axis, the j-th of the first.

    A place stands for the latent z there; E is taken at sqrt(alpha_bar) z, the mean of q(z_t | z), so that
    dE/dx = sqrt(alpha_bar) eps(sqrt(alpha_bar) z, t) . axis.

    Args:
        predict: guided noise.
        step: number of the step of a run.
        signal: alpha_bar of its timestep.
        plane: of the latents.
        places: along the first and the second axis, (G,) each.
        after_row: called after every G runs of the model; may raise to stop.

    Raises:
        NonFiniteError: the model produced NaN or infinity.
    """
    root = np.sqrt(signal)
    field = np.empty((len(places[1]), len(places[0]), 2))
    for i, second in enumerate(places[1]):
        for j, first in enumerate(places[0]):
            noise = predict((root * plane.latent(first, second))[None].astype(np.float32), step)
            field[i, j] = root * (plane.axes @ noise.ravel())
        if not np.isfinite(field[i]).all():
            raise NonFiniteError("the predicted noise is not finite; the bundle's weights are broken")
        after_row()
    return field


def edge_integrals(field: DoubleArray, spacing: float) -> DoubleArray:
    """Of a field (G, G, 2) along the edges of its grid: first those along the first axis, then along the second."""
    across = (field[:, :-1, 0] + field[:, 1:, 0]) / 2
    along = (field[:-1, :, 1] + field[1:, :, 1]) / 2
    return spacing * np.concatenate([across.ravel(), along.ravel()])


def potential(field: DoubleArray, spacing: float) -> tuple[DoubleArray, float]:
    """The energy (G, G), and the share of the field (root of squares) that is no gradient of it.

    Args:
        field: (G, G, 2) see `noise_field`.
        spacing: between neighbours.
    """
    size = len(field)
    wanted = edge_integrals(field, spacing)
    step = np.diff(np.eye(size), axis=0)
    differences = np.concatenate([np.kron(np.eye(size), step), np.kron(step, np.eye(size))])
    # the added constant asks for mean 0, which the differences leave open
    energy = np.linalg.solve(differences.T @ differences + 1 / size**2, differences.T @ wanted)
    rest = np.linalg.norm(differences @ energy - wanted) / max(float(np.linalg.norm(wanted)), 1e-12)
    return energy.reshape(size, size), float(rest)


@dataclass(frozen=True)
class EnergyMap:
    """Of one way to predict the noise."""

    label: str
    energy: DoubleArray
    """(GRID, GRID), least value 0; [i, j] is at `second[i]`, `first[j]`."""
    sample: DoubleArray
    """(2,) where its own sample ends on the plane, from the same noise and the same coarser latents."""
    off_plane: float
    """How far beside the plane that is, in the unit of the axes."""
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
    """Each concept, the composition, the joint text."""
    first: DoubleArray
    """(GRID,) places along the first axis."""
    second: DoubleArray
    """(GRID,)."""
    timestep: int
    """Of the schedule's table."""

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Write a `.png`.

        Raises:
            OutputError: it cannot be written there; see `files.check_target`.
            MissingExtraError: matplotlib is not installed (`pip install "kinegraph[plot]"`).
        """
        from kinegraph.files import check_target, write_atomically
        from kinegraph.formats import check_installed

        check_target(path, force, (".png",))
        check_installed(".png")
        from kinegraph.formats.energy_png import encode

        write_atomically(path, encode(self), force=force)

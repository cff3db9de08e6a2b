"""Draw energy maps as a `.png`: one contour map per prediction, on one colour scale. Needs the `plot` extra."""

from __future__ import annotations

import os
import textwrap
from typing import TYPE_CHECKING, Final

import numpy as np

from kinegraph.files import check_target, write_atomically
from kinegraph.formats import check_installed
from kinegraph.formats.contact_sheet import GREY, png_bytes, title_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kinegraph.diffusion.energy import EnergyMap, EnergyMaps

CONTOURS: Final = 13
PER_LINE: Final = 4
BESIDE: Final = 0.05
"""Share of the map's side: a sample further from the plane is drawn hollow."""
_OWN, _OTHERS = "#dc2626", "#fafafa"


def check_energy_target(path: str | os.PathLike[str], force: bool = False) -> None:
    """Refuse a path that energy maps could not be saved to, before anything is computed for it.

    Args:
        path: file to write, ending in `.png`.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: see `files.check_target`. Nothing has been written.
        MissingExtraError: matplotlib is not installed.
    """
    check_target(path, force, (".png",))
    check_installed(".png")


def save_energy_maps(energies: EnergyMaps, path: str | os.PathLike[str], *, force: bool = False) -> None:
    """Write energy maps as a `.png`; the file appears complete or not at all.

    Args:
        energies: of `kinegraph.energy.energy_maps`.
        path: file to write, in a folder that exists.
        force: replace an existing file.

    Raises:
        OutputError: the file cannot be written there; see `files.check_target`.
        MissingExtraError: matplotlib is not installed (`pip install "kinegraph[plot]"`).
    """
    check_energy_target(path, force)
    write_atomically(path, encode(energies), force=force)


def encode(energies: EnergyMaps) -> bytes:
    """Encode energy maps as PNG; equal maps give equal bytes."""
    from matplotlib.figure import Figure

    lines = -(-len(energies.maps) // PER_LINE)
    columns = min(len(energies.maps), PER_LINE)
    figure = Figure(figsize=(2.6 * columns + 0.8, 3.0 * lines + 0.4), dpi=80, layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False)
    highest = max(1e-6, *(float(energy_map.energy.max()) for energy_map in energies.maps))
    # rings of a bowl are evenly spaced when their heights grow with the square
    levels = highest * np.linspace(0, 1, CONTOURS) ** 2
    for number, (axis, energy_map) in enumerate(zip(axes.flat, energies.maps, strict=False), start=1):
        filled = axis.contourf(energies.first, energies.second, energy_map.energy, levels=levels, cmap="viridis")
        axis.contour(energies.first, energies.second, energy_map.energy, levels=levels, colors=_OTHERS, linewidths=0.4)
        _draw_samples(axis, energies, energy_map)
        axis.set_title(_title(number, energy_map.label), fontsize=8, color=GREY)
        axis.set_aspect("equal")
        axis.tick_params(labelsize=6, colors=GREY)
    for axis in axes.flat[len(energies.maps) :]:
        axis.axis("off")
    bar = figure.colorbar(filled, ax=axes, shrink=0.8, pad=0.01, ticks=levels[::4], format="%.2g")
    bar.set_label("energy above the lowest", fontsize=7, color=GREY)
    bar.ax.tick_params(labelsize=6, colors=GREY)
    rest = max(energy_map.rest for energy_map in energies.maps)
    note = (
        "stars and dots: where samples end, hollow beside the plane; unit: standard deviation of the specific latent; "
        f"timestep {energies.timestep}; at most {rest:.0%} of the noise is no gradient"
    )
    figure.supxlabel(note, fontsize=7, color=GREY)
    return png_bytes(figure)


def _draw_samples(axis: Axes, energies: EnergyMaps, own: EnergyMap) -> None:
    """Mark where all samples end: this map's own as a star, hollow where it lies beside the plane."""
    size = energies.first[-1] - energies.first[0]
    for number, other in enumerate(energies.maps, start=1):
        if other is not own:
            x, y = other.sample
            axis.plot(x, y, "o", color=_OTHERS, markersize=3)
            axis.annotate(f"{number}", (x, y), (3, 3), textcoords="offset points", fontsize=7, color=_OTHERS)
    fill = "none" if own.off_plane > BESIDE * size else "full"
    axis.plot(*own.sample, "*", markersize=13, markeredgecolor=_OTHERS, markeredgewidth=0.8, color=_OWN, fillstyle=fill)


def _title(number: int, label: str) -> str:
    """Wrap the title of a map to at most three lines."""
    return "\n".join(textwrap.wrap(title_line(f"{number}. {label}", 90), 34)[:3])

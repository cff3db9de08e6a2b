"""Feature layouts of training: losses against the runtime's own conversions, normalisation, presets."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from kinegraph.motion.features import normalisation
from kinegraph.motion.skeleton import FEET
from kinegraph_training.layouts import HUMANML3D_263, JOINTS_137, LAYOUTS, layout_of, measure_normalisation
from kinegraph_training.losses import foot_displacement, integrate_path, local_joints
from kinegraph_training.metrics import reconstruction_scores
from support.motions import walk

FORMS = tuple(LAYOUTS.values())


def rows_of(form: object, **options: float) -> np.ndarray:
    return form.from_joints(walk(40, **options))  # type: ignore[attr-defined]


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_paths_of_the_loss_are_those_of_the_clip(form: object) -> None:
    rows = rows_of(form, turning=0.05)
    joints = form.to_joints(rows)  # type: ignore[attr-defined]
    path = integrate_path(torch.tensor(rows)[None].double(), len(rows))[0].numpy()
    np.testing.assert_allclose(path[:-1, 1:], joints[1:, 0, [0, 2]], atol=1e-4)
    assert path[-1, 0] > 1.5, "a walk that turns left"


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_feet_of_the_loss_move_as_those_of_the_clip(form: object) -> None:
    """The displacement of a foot has the same length in any frame of reference."""
    rows = rows_of(form, turning=-0.04)
    joints = form.to_joints(rows)  # type: ignore[attr-defined]
    tensor = torch.tensor(rows)[None].double()
    moved = foot_displacement(tensor, local_joints(tensor))[0].numpy()
    expected = np.diff(joints[:, list(FEET)].astype(np.float64), axis=0)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=-1), np.linalg.norm(expected, axis=-1), atol=2e-4)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_scores_compare_any_layout(form: object) -> None:
    rows = rows_of(form)
    moved = rows.copy()
    moved[:, 3] += 0.01
    assert reconstruction_scores(rows, rows)["global_mm"] == 0.0
    assert 0.4 < reconstruction_scores(moved, rows)["global_mm"] < 10.1


def test_normalisation_in_one_pass_is_that_of_all_rows() -> None:
    clips = [JOINTS_137.from_joints(walk(30 + 7 * index, turning=0.01 * index)) for index in range(4)]
    for one_pass, at_once in zip(measure_normalisation(iter(clips), JOINTS_137), normalisation(clips), strict=True):
        np.testing.assert_allclose(one_pass, at_once, rtol=1e-5, atol=1e-6)
    rows = HUMANML3D_263.from_joints(walk(60))
    _, std = measure_normalisation([rows], HUMANML3D_263)
    for group in HUMANML3D_263.groups:
        assert len(set(std[group].tolist())) == 1
        deviation = float(np.sqrt(rows[:, group].astype(np.float64).var(axis=0).mean()))
        assert std[group][0] == pytest.approx(deviation if deviation > 1e-6 else 1.0, rel=1e-3)


def test_widths_that_no_layout_has() -> None:
    with pytest.raises(ValueError, match=r"138 wide; `features` in \[vae.shared\] must be 137 \(joints-137\), 263"):
        layout_of(138)

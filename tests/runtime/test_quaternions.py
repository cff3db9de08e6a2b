"""Quaternions against rotation matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.motion import quaternions as q
from support.motions import turn

angles = st.floats(-3.1, 3.1)


def matrix_of(z: float, x: float, y: float) -> np.ndarray:
    return turn("z", z) @ turn("x", x) @ turn("y", y)


def quaternion_of(z: float, x: float, y: float) -> np.ndarray:
    parts = [q.about_axis(axis, np.array(angle)) for axis, angle in ((2, z), (0, x), (1, y))]
    return q.multiply(q.multiply(parts[0], parts[1]), parts[2])


def directions(count: int) -> np.ndarray:
    return q.normalised(np.random.default_rng(3).normal(size=(count, 3)))


@given(angles, angles, angles)
def test_products_and_matrices_agree(z: float, x: float, y: float) -> None:
    matrix, rotation = matrix_of(z, x, y), quaternion_of(z, x, y)
    np.testing.assert_allclose(q.to_matrix(rotation), matrix, atol=1e-12)
    np.testing.assert_allclose(q.rotate(rotation, np.array([0.3, -2.0, 0.7])), matrix @ [0.3, -2.0, 0.7], atol=1e-12)
    np.testing.assert_allclose(q.to_matrix(q.conjugate(rotation)), matrix.T, atol=1e-12)
    again = q.from_matrix(matrix)
    assert again[0] >= 0
    np.testing.assert_allclose(q.to_matrix(again), matrix, atol=1e-9)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_half_turns_from_matrices(axis: str) -> None:
    matrix = turn(axis, np.pi)
    np.testing.assert_allclose(q.to_matrix(q.from_matrix(matrix)), matrix, atol=1e-12)


def test_shortest_rotation_takes_one_direction_to_the_other() -> None:
    start, end = directions(50), directions(100)[50:]
    rotation = q.shortest_rotation(start * 3.0, end * 0.2)
    np.testing.assert_allclose(q.rotate(rotation, start), end, atol=1e-9)
    np.testing.assert_allclose(2 * np.arccos(rotation[:, 0]), np.arccos((start * end).sum(-1)), atol=1e-6)


def test_shortest_rotation_of_opposite_equal_and_zero_directions() -> None:
    start = directions(20)
    opposite = q.shortest_rotation(start, -start)
    np.testing.assert_allclose(q.rotate(opposite, start), -start, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(opposite, axis=-1), 1.0)
    np.testing.assert_allclose(q.shortest_rotation(start, start), np.tile(q.IDENTITY, (20, 1)), atol=1e-12)
    np.testing.assert_array_equal(q.shortest_rotation(np.zeros(3), start[0]), q.IDENTITY)


def test_slerp_goes_the_shorter_way_at_even_speed() -> None:
    first, second = quaternion_of(0, 0, 0.2), quaternion_of(0, 0, 1.4)
    for sign in (1.0, -1.0):
        for share in (0.0, 0.25, 0.5, 1.0):
            mixed = q.slerp(first, sign * second, np.array(share))
            np.testing.assert_allclose(q.to_matrix(mixed), turn("y", 0.2 + 1.2 * share), atol=1e-12)
    close = q.slerp(first, quaternion_of(0, 0, 0.2 + 1e-6), np.array(0.5))
    np.testing.assert_allclose(q.to_matrix(close), turn("y", 0.2 + 5e-7), atol=1e-10)


def test_continuous_signs_keeps_the_rotations() -> None:
    smooth = q.about_axis(1, np.linspace(0.0, 9.0, 40))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(40, 1))
    signs[0] = 1.0
    np.testing.assert_allclose(q.continuous_signs(smooth * signs), smooth)


def test_quaternions_keep_float32() -> None:
    rotation = q.about_axis(0, np.array([0.3], dtype=np.float32))
    ahead = np.array([[0, 0, 1]], dtype=np.float32)
    results = [q.multiply(rotation, rotation), q.rotate(rotation, ahead), q.shortest_rotation(ahead, -ahead)]
    assert {result.dtype for result in [*results, q.to_matrix(rotation)]} == {np.dtype(np.float32)}

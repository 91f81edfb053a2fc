from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from codecbench.slam.geometry import rotations
from codecbench.slam.geometry import transforms as tf

pytestmark = pytest.mark.thorough

SIZES = [1e-9, 1e-5, 1e-2, 0.299, 0.301, 1.0, 2.5]
components = st.floats(-1.5, 1.5)
tangents = st.tuples(*[components] * 7).map(np.array)


def algebra(tangent: np.ndarray) -> np.ndarray:
    """The (4, 4) matrix whose matrix exponential is the similarity."""
    out = np.zeros((4, 4))
    out[:3, :3] = rotations.skew(tangent[3:6]) + tangent[6] * np.eye(3)
    out[:3, 3] = tangent[:3]
    return out


@pytest.mark.parametrize("size", SIZES)
def test_sim3_exp_is_the_matrix_exponential_and_log_its_inverse(size: float, rng: np.random.Generator) -> None:
    for _ in range(20):
        tangent = rng.normal(size=7)
        tangent[3:6] *= size / np.linalg.norm(tangent[3:6])
        tangent[6] *= 0.5 * size
        similarity = tf.sim3_exp(tangent)
        np.testing.assert_allclose(similarity, expm(algebra(tangent)), rtol=0, atol=1e-12)
        np.testing.assert_allclose(tf.sim3_log(similarity), tangent, rtol=0, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, *SIZES, np.pi - 1e-3, np.pi - 1e-9, np.pi])
def test_so3_agrees_with_scipy_up_to_half_a_turn(size: float, rng: np.random.Generator) -> None:
    for _ in range(20):
        vector = rng.normal(size=3)
        vector *= size / np.linalg.norm(vector)
        rotation = rotations.so3_exp(vector)
        np.testing.assert_allclose(rotation, Rotation.from_rotvec(vector).as_matrix(), atol=1e-15 + 1e-15 * size)
        logarithm = rotations.so3_log(rotation)
        np.testing.assert_allclose(rotations.so3_exp(logarithm), rotation, atol=1e-14)
        assert np.linalg.norm(logarithm) <= np.pi + 1e-15


def test_quaternions_agree_with_scipy(rng: np.random.Generator) -> None:
    half_turns = np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])
    for rotation in [*Rotation.random(200, rng=rng).as_matrix(), *half_turns]:
        quaternion = rotations.quaternion_from_rotation(rotation)
        expected = Rotation.from_matrix(rotation).as_quat(canonical=True)
        assert abs(abs(quaternion @ expected) - 1.0) < 1e-14
        assert quaternion[3] >= 0.0
        np.testing.assert_allclose(rotations.rotation_from_quaternion(3.0 * quaternion), rotation, atol=1e-14)


@given(tangents, tangents)
def test_group_laws_of_similarities(x: np.ndarray, y: np.ndarray) -> None:
    a, b = tf.sim3_exp(x), tf.sim3_exp(y)
    np.testing.assert_allclose(tf.sim3_compose(a, b), a @ b, atol=1e-12)
    np.testing.assert_allclose(tf.sim3_inverse(a) @ a, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(a @ tf.sim3_exp(0.1 * y), tf.sim3_exp(0.1 * tf.sim3_adjoint(a) @ y) @ a, atol=1e-9)
    np.testing.assert_allclose(tf.sim3_from_parts(*tf.sim3_to_parts(a)), a, atol=1e-12)


@given(tangents)
def test_rigid_motions_are_similarities_of_scale_one(x: np.ndarray) -> None:
    motion = tf.se3_exp(x[:6])
    assert tf.sim3_scale(motion) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(tf.se3_inverse(motion), np.linalg.inv(motion), atol=1e-12)
    np.testing.assert_allclose(tf.se3_exp(tf.se3_log(motion)), motion, atol=1e-12)


def test_orthonormalize_returns_to_the_rotations(rng: np.random.Generator) -> None:
    rotation = rotations.so3_exp(np.array([0.3, -0.8, 1.1]))
    repaired = rotations.orthonormalize(rotation + rng.normal(0.0, 1e-9, (3, 3)))
    np.testing.assert_allclose(repaired @ repaired.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(repaired, rotation, atol=1e-8)


def test_kernels_run_inside_compiled_code() -> None:
    @njit
    def there_and_back(tangent: np.ndarray) -> np.ndarray:
        return tf.sim3_log(tf.sim3_compose(tf.sim3_exp(tangent), tf.sim3_exp(tangent)))

    tangent = np.array([0.1, 0.2, 0.3, 0.0, 0.1, -0.2, 0.3])
    np.testing.assert_allclose(there_and_back(tangent), 2.0 * tangent, atol=1e-13)


@pytest.mark.parametrize("with_scale", [True, False])
def test_alignment_recovers_a_similarity_exactly(with_scale: bool, rng: np.random.Generator) -> None:
    points_b = rng.normal(size=(12, 3))
    truth = tf.sim3_exp(np.array([1.0, -2.0, 3.0, 0.5, -2.0, 1.0, 0.7 if with_scale else 0.0]))
    points_a = points_b @ truth[:3, :3].T + truth[:3, 3]
    scale, rotation, translation = tf.align_points(points_a, points_b, with_scale)
    np.testing.assert_allclose(tf.sim3_from_parts(scale, rotation, translation), truth, atol=1e-12)
    assert with_scale or scale == 1.0


def test_alignment_returns_a_rotation_even_for_mirrored_and_flat_points(rng: np.random.Generator) -> None:
    points = rng.normal(size=(10, 3))
    flat = points * [1.0, 1.0, 0.0]
    for points_a, points_b in ((points * [1, 1, -1], points), (flat, flat)):
        assert np.linalg.det(tf.align_points(points_a, points_b, True)[1]) == pytest.approx(1.0)
    np.testing.assert_allclose(tf.align_points(flat, flat, True)[1], np.eye(3), atol=1e-12)


def test_alignment_is_the_least_squares_optimum(rng: np.random.Generator) -> None:
    points_b = rng.normal(size=(30, 3))
    points_a = 2.0 * points_b + rng.normal(0.0, 0.1, (30, 3))
    best = tf.sim3_from_parts(*tf.align_points(points_a, points_b, True))

    def error(similarity: np.ndarray) -> float:
        return float(((points_a - points_b @ similarity[:3, :3].T - similarity[:3, 3]) ** 2).sum())

    for _ in range(50):
        assert error(tf.sim3_exp(rng.normal(0.0, 1e-3, 7)) @ best) > error(best)

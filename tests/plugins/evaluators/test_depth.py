"""The `depth` evaluator on scenes whose distances, edges and planes are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from memory_sequence import MemorySequence

from codecbench.core.contracts.evaluator import CodedFrame
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera, Depth, Frame
from codecbench.plugins.evaluators.depth import DepthEvaluator
from codecbench.plugins.evaluators.depth_surfaces import edges_of

CAMERA = Camera(105, 90, 100.0, 110.0, 50.0, 42.0)
MILLIMETERS = Depth(0.001)
NAMES = {metric.name for metric in DepthEvaluator.metrics}
ANGLES = {"normal_error_deg", "plane_angle_deg"}
RANGES = {f"relative_error_{name}_percent" for name in ("below_1m", "1_to_2m", "2_to_4m", "from_4m")}


class Coded(list[CodedFrame]):
    """A coded sequence of one frame."""

    def __init__(self, original: Image, decoded: Image, depth: Depth, camera: Camera | None) -> None:
        super().__init__([CodedFrame(Frame(0, 0.0, original), b"", decoded)])
        self.sequence = MemorySequence([original], camera)
        self.sequence.bits, self.sequence.depth = 16, depth


def measured(
    original: Image, decoded: Image, depth: Depth = MILLIMETERS, camera: Camera | None = CAMERA, **params: float
) -> dict[str, float]:
    """The values of one frame; each metric has one, and a reason exactly if it is missing."""
    coded = Coded(original.astype(np.uint16), decoded.astype(np.uint16), depth, camera)
    found = list(DepthEvaluator.create(**params).evaluate(coded, None))  # type: ignore[arg-type]
    assert sorted(value.metric for value in found) == sorted(NAMES)
    assert all(value.frame == 0 and math.isnan(value.value) == bool(value.reason) for value in found)
    return {value.metric: value.value for value in found}


def missing(values: dict[str, float]) -> set[str]:
    return {name for name, value in values.items() if math.isnan(value)}


def wall(distance: float, shape: tuple[int, int] = (90, 105)) -> Image:
    return np.full(shape, distance, np.uint16)


def plane(tilt_deg: float, unit_m: float, distance_m: float = 1.5) -> np.ndarray:
    """Distances of a plane through (0, 0, distance_m), turned about the camera's y axis, in steps."""
    rays = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    row = distance_m / (1.0 + math.tan(math.radians(tilt_deg)) * rays) / unit_m
    return np.broadcast_to(row, (CAMERA.height, CAMERA.width))


def room() -> Image:
    """A tilted floor before four walls, one in each range, with a hole."""
    scene = plane(10.0, 0.001).round().astype(np.uint16)
    for number, distance in enumerate((800, 1700, 3000, 6000)):
        scene[:60, 26 * number : 26 * number + 26] = distance
    scene[70:75, 20:30] = 0
    return scene


def test_equal_frames_have_no_error_at_all() -> None:
    assert measured(room(), room()) == dict.fromkeys(NAMES, 0.0)


@pytest.mark.parametrize("depth", [Depth(0.0005), Depth(0.0005, 65535)])
def test_an_offset_is_measured_in_millimeters_and_in_noise(depth: Depth) -> None:
    values = measured(wall(4000), wall(4007), depth, noise_per_m=0.002)
    for name in ("mean_error_mm", "median_error_mm", "p99_error_mm", "worst_error_mm", "surface_error_mm"):
        assert values[name] == pytest.approx(3.5)
    assert values["plane_offset_mm"] == pytest.approx(3.5, abs=0.01)  # planes are fitted in single precision
    assert values["noise_ratio"] == pytest.approx(0.0035 / (0.002 * 2.0**2))
    assert values["relative_error_2_to_4m_percent"] == pytest.approx(0.175)
    assert values["normal_error_deg"] == pytest.approx(0.0, abs=1e-3)
    assert missing(values) == {"edge_error_mm", *RANGES - {"relative_error_2_to_4m_percent"}}


def test_errors_are_those_of_numpy(rng: np.random.Generator) -> None:
    original, decoded = (rng.integers(0, 7000, (40, 50)) for _ in range(2))
    values, known = measured(original, decoded), (original > 0) & (decoded > 0)
    distances, errors = original[known] / 1000.0, np.abs(original - decoded)[known].astype(float)
    assert values["mean_error_mm"] == pytest.approx(errors.mean())
    for name, share in (("median_error_mm", 50), ("p99_error_mm", 99), ("worst_error_mm", 100)):
        assert values[name] == pytest.approx(np.percentile(errors, share, method="inverted_cdf"))
    ratios = errors / 1000.0 / (1.425e-3 * distances**2)
    changed = np.count_nonzero((original > 0) != (decoded > 0))
    squares = (np.minimum(ratios, 10.0) ** 2).sum() + 100.0 * changed
    assert values["noise_ratio"] == pytest.approx(np.sqrt(squares / (known.sum() + changed)))
    limits = (0.0, 1.0, 2.0, 4.0, np.inf)
    for name, low, high in zip(("below_1m", "1_to_2m", "2_to_4m", "from_4m"), limits, limits[1:], strict=False):
        there = (distances >= low) & (distances < high)
        expected = (100.0 * errors / 1000.0 / distances)[there].mean()
        assert values[f"relative_error_{name}_percent"] == pytest.approx(expected)


def test_noise_of_the_sensor_is_one_noise_of_the_sensor(rng: np.random.Generator) -> None:
    original = rng.integers(4000, 40_000, (200, 200))
    decoded = original + rng.normal(0.0, 1.425e-3 * (original * 1e-4) ** 2 / 1e-4)
    assert measured(original, decoded.round(), Depth(1e-4))["noise_ratio"] == pytest.approx(1.0, abs=0.02)


def test_one_percent_of_gained_lost_or_gross_pixels_is_as_much_as_the_noise_of_the_sensor() -> None:
    whole, holed, gross = wall(2000, (20, 50)), wall(2000, (20, 50)), wall(2000, (20, 50))
    holed[3, :10], gross[3, :10] = 0, 4000
    for original, decoded in ((whole, holed), (holed, whole), (whole, gross)):
        assert measured(original, decoded)["noise_ratio"] == pytest.approx(1.0)


def test_rounding_to_ten_millimeters_errs_by_two_and_a_half() -> None:
    original = np.arange(1000, 3000).reshape(40, 50)
    values = measured(original, (original + 5) // 10 * 10)
    assert values["mean_error_mm"] == pytest.approx(2.5)
    assert values["worst_error_mm"] == 5.0


def test_a_blurred_edge_flies_and_a_moved_one_does_not() -> None:
    original = wall(1000, (20, 40))
    original[:, 20:] = 2000
    blurred, left, right = original.copy(), original.copy(), original.copy()
    blurred[:, 19], blurred[:, 20], left[:, 19], right[:, 20] = 1333, 1667, 2000, 1000
    values = measured(original, blurred)
    assert values["flying_percent"] == pytest.approx(100.0 * 2 / 40)
    assert values["edge_error_mm"] == pytest.approx(2 * 333 / 4)  # two columns on each side of the edge
    assert values["surface_error_mm"] == 0.0
    assert measured(original, left)["flying_percent"] == measured(original, right)["flying_percent"] == 0.0
    assert measured(original, blurred, edge_jump=0.6)["flying_percent"] == pytest.approx(5.0)
    assert measured(original, blurred, edge_jump=0.7)["flying_percent"] == 0.0, "333 mm are less than half of the jump"


def test_what_a_hole_pulls_to_the_camera_flies() -> None:
    original = wall(1000, (20, 40))
    original[:, 30:] = 0
    decoded = original.copy()
    decoded[:, 29] = 500
    assert measured(original, decoded)["flying_percent"] == pytest.approx(100.0 / 30)


@pytest.mark.parametrize("unknown", [0, 65535])
def test_pixels_gain_and_lose_distances(unknown: int) -> None:
    original, decoded = wall(1500, (40, 50)), wall(1500, (40, 50))
    original[:3, :10], decoded[30:32, :] = unknown, unknown
    values = measured(original, decoded, Depth(0.001, unknown))
    assert values["invented_percent"] == pytest.approx(1.5)
    assert values["lost_percent"] == pytest.approx(5.0)
    assert {values[name] for name in ("worst_error_mm", "normal_error_deg", "plane_offset_mm")} == {0.0}


@pytest.mark.parametrize("tilt_deg", [-20.0, 0.0, 35.0])
def test_a_plane_turned_by_two_degrees_is_two_degrees_off(tilt_deg: float) -> None:
    before, after = plane(tilt_deg, 5e-5), plane(tilt_deg + 2.0, 5e-5)
    values = measured(before.round(), after.round(), Depth(5e-5))
    assert values["normal_error_deg"] == pytest.approx(2.0, abs=0.02)
    assert values["plane_angle_deg"] == pytest.approx(2.0, abs=0.005)
    centers = np.abs(after - before)[7::15, 7::15] * 0.05
    assert values["plane_offset_mm"] == pytest.approx(centers.mean(), abs=0.01)


def test_curved_patches_are_no_planes_but_have_normals() -> None:
    y, x = np.indices((90, 105)) % 15 - 7.0
    bowls = 1000.0 - 2.0 * (x**2 + y**2)
    assert missing(measured(bowls, bowls, edge_jump=0.5)) & (ANGLES | {"plane_offset_mm"}) == {
        "plane_angle_deg", "plane_offset_mm",
    }  # fmt: skip


@pytest.mark.parametrize("camera", [None, Camera(105, 90, 100.0, 100.0, 50.0, 42.0, model="equidistant")])
def test_angles_need_a_pinhole_camera(camera: Camera | None) -> None:
    assert missing(measured(room(), room(), camera=camera)) == ANGLES


def test_frames_without_a_distance_have_shares_only() -> None:
    values = measured(wall(0), wall(900))
    assert (values["invented_percent"], values["noise_ratio"]) == (100.0, 10.0)
    assert missing(values) == NAMES - {"invented_percent", "lost_percent", "noise_ratio"}
    assert missing(measured(wall(0), wall(0))) == NAMES - {"invented_percent", "lost_percent"}


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (3, 3), (7, 8)])
@pytest.mark.parametrize("distance", [0, 1, 1200, 65535])
def test_small_frames_and_extreme_distances(shape: tuple[int, int], distance: int) -> None:
    values = measured(wall(distance, shape), wall(1201, shape), Depth(0.001, 5))
    assert values["worst_error_mm"] == pytest.approx(abs(distance - 1201))
    assert math.isfinite(values["noise_ratio"])
    assert math.isnan(values["normal_error_deg"]) == (min(shape) < 7)


@pytest.mark.parametrize("radius_px", [1, 2, 3])
def test_edges_are_those_of_a_search(radius_px: int, rng: np.random.Generator) -> None:
    image = rng.integers(1000, 1030, (14, 15)).astype(np.uint16)
    image[:, 9:] += 60
    image[2, 3] = 7
    edges = edges_of(image, 7, radius_px, 0.05)

    def around(row: int, column: int, reach: int) -> Image:
        return image[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]

    def jumps(row: int, column: int) -> bool:
        known = around(row, column, 1)[around(row, column, 1) != 7].astype(float)
        return bool(known.max() > 1.05 * known.min())

    for row, column in np.ndindex(image.shape):
        square = around(row, column, radius_px)
        reach = range(-(radius_px - 1), radius_px)
        near_jump = any(
            jumps(row + down, column + right)
            for down in reach for right in reach
            if 0 <= row + down < 14 and 0 <= column + right < 15
        )  # fmt: skip
        assert edges.mask[row, column] == (near_jump or 7 in square)
        assert edges.near[row, column] == square[square != 7].min()
        assert edges.far[row, column] == square.max()

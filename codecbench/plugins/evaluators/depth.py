"""The `depth` evaluator measures what a codec changes in the distances of a depth sequence.

Sources: the noise of structured light, Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data for
indoor mapping applications", Sensors 12(2), 2012, doi:10.3390/s120201437: a disparity noise of half a pixel at 2.85e-5
per cm is 1.425e-3 z^2 in meters, 4 cm at 5 m.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.evaluator import CodedFrame, CodedSequence, Context, Measurement, SequenceEvaluator
from codecbench.core.contracts.metric import Metric, Scale
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import Camera, Depth
from codecbench.core.kernels.compiled import compiled
from codecbench.plugins.evaluators.depth_surfaces import Edges, Patches, cut, edges_of, fit_patches

NORMAL_PX: Final = 7
PLANE_PX: Final = 15
"""Sides of patches for normals and for planes: odd, so that they are not the blocks of a codec."""
RANGES_M: Final = (1.0, 2.0, 4.0)
"""Limits between the ranges of distance in which relative errors are averaged."""
_RANGES: Final = {"below_1m": "below 1 m", "1_to_2m": "1 to 2 m", "2_to_4m": "2 to 4 m", "from_4m": "from 4 m"}
_GROSS: Final = 10.0
"""What pixels without comparable distances count as in the ratio of noise, and the most that any counts as."""
_NOTHING: Final = "no pixel or patch of this kind has its distances in both frames"


class DepthParams(Params):
    """Describe the noise of the sensor and what an edge is.

    noise_per_m: standard deviation of the sensor's distances over the squared distance, in 1/m, as of sensors that
    triangulate; the default is of structured light (see the module). edge_jump: difference of distances within 3x3
    pixels beyond which there is an edge, as a share of the smallest. edge_px: how far an edge reaches, in pixels.
    """

    noise_per_m: Annotated[float, Field(gt=0.0, le=1.0)] = 1.425e-3
    edge_jump: Annotated[float, Field(gt=0.0, le=1.0)] = 0.05
    edge_px: Annotated[int, Field(ge=1, le=20)] = 2


def _metric(name: str, unit: str, summary: str, label: str, column_header: str = "", **options: Any) -> Metric:
    """A quality that is better when lower; with a column header it is a headline."""
    scale: Scale = "linear" if unit in ("%", "deg") else "log"
    options = {"role": "quality", "label": label, "column_header": column_header} | options
    return Metric(name, unit, "lower", summary, scale=scale, headline=bool(column_header), **options)


class DepthEvaluator(SequenceEvaluator[DepthParams]):
    """Errors of distances, pixels that gain or lose one, flying pixels, and errors of normals and planes.

    docs/metrics.md defines each metric. All are 0 for a lossless codec. Normals and angles of planes need a pinhole
    camera.
    """

    name = "depth"
    version = "1"
    needs = frozenset({"depth"})
    bits = (16,)
    kernels = ("codecbench.plugins.evaluators.depth",)
    params_type = DepthParams
    typical_ms_per_frame = 25.0
    metrics: ClassVar[tuple[Metric, ...]] = (
        _metric(
            "noise_ratio", "1", "RMS of the error over noise_per_m times the squared distance; gross errors are 10",
            "error over sensor noise", "error /\nnoise", enough=1.0, role="task",
            shown_with="mean_error_mm",
        ),
        _metric("mean_error_mm", "mm", "mean absolute error", "mean error", "error mm"),
        _metric("median_error_mm", "mm", "median absolute error", "median error"),
        _metric("p99_error_mm", "mm", "99th percentile of absolute errors", "99 % error"),
        _metric("worst_error_mm", "mm", "largest absolute error", "worst error", aggregates=("max",)),
        _metric("edge_error_mm", "mm", "mean absolute error, near edges", "mean error, near edges"),
        _metric("surface_error_mm", "mm", "mean absolute error, elsewhere", "mean error, elsewhere"),
        *(
            _metric(
                f"relative_error_{name}_percent", "%", f"mean absolute error over distance, {where}",
                f"relative error, {where}",
            )
            for name, where in _RANGES.items()
        ),
        _metric("invented_percent", "%", "pixels of the frame that gain a distance", "invented pixels", "new\n%"),
        _metric("lost_percent", "%", "pixels of the frame that lose their distance", "lost pixels", "lost\n%"),
        _metric(
            "flying_percent", "%", "pixels near edges that leave every surface around them, of pixels known in both",
            "flying pixels", "flying\n%",
        ),
        _metric("normal_error_deg", "deg", "mean angle between normals of 7x7 px surface patches", "error of normals"),
        _metric("plane_angle_deg", "deg", "mean angle between planes of flat 15x15 px patches", "angle of planes"),
        _metric(
            "plane_offset_mm", "mm", "mean distance between planes at the centers of flat 15x15 px patches",
            "offset of planes",
        ),
    )  # fmt: skip

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        depth, camera = coded.sequence.depth, coded.sequence.camera
        assert depth is not None  # see `needs`
        camera = camera if camera is not None and camera.model == "pinhole" else None
        for index, frame in enumerate(coded):
            for metric, value in self._values(frame, depth, camera).items():
                no_angle = camera is None and metric.endswith("_deg")
                reason = "the sequence has no pinhole camera" if no_angle else _NOTHING
                yield Measurement(metric, value, index, reason=reason if math.isnan(value) else None)

    def _values(self, frame: CodedFrame, depth: Depth, camera: Camera | None) -> dict[str, float]:
        """The value of each metric; NaN if there is nothing to measure."""
        params, unknown = self.params, depth.unknown
        before, after = frame.original.image != unknown, frame.decoded != unknown
        edges = frame.original.cached(
            ("depth_edges", unknown, params.edge_px, params.edge_jump),
            lambda image: edges_of(image, unknown, params.edge_px, params.edge_jump),
        )
        return {
            "invented_percent": 100.0 * float(np.mean(after & ~before)),
            "lost_percent": 100.0 * float(np.mean(before & ~after)),
            **self._errors(frame, unknown, edges, depth.unit_m),
            **self._surfaces(frame, after & ~edges.mask, depth.unit_m, camera),
        }

    def _errors(self, frame: CodedFrame, unknown: int, edges: Edges, unit_m: float) -> dict[str, float]:
        """Errors of the pixels with a distance in both frames."""
        counts, ranges, squares, flying, changed = _compare(
            frame.original.image, frame.decoded, unknown, edges, self.params.edge_jump / 2, unit_m,
            self.params.noise_per_m,
        )  # fmt: skip
        steps, of_all = np.arange(counts.shape[1]), counts.sum(axis=0)
        known, up_to, step_mm = int(of_all.sum()), np.cumsum(of_all), 1e3 * unit_m
        ranked = np.searchsorted(up_to, np.array([0.5, 0.99, 1.0]) * known) * (step_mm if known else math.nan)
        return {
            "noise_ratio": math.sqrt(_ratio(squares, known + changed)),
            "mean_error_mm": step_mm * _ratio(steps @ of_all, known),
            **dict(zip(("median_error_mm", "p99_error_mm", "worst_error_mm"), ranked.tolist(), strict=True)),
            "edge_error_mm": step_mm * _ratio(steps @ counts[1], counts[1].sum()),
            "surface_error_mm": step_mm * _ratio(steps @ counts[0], counts[0].sum()),
            **{f"relative_error_{name}_percent": 100.0 * _ratio(*of) for name, of in zip(_RANGES, ranges, strict=True)},
            "flying_percent": 100.0 * _ratio(flying, known),
        }

    def _surfaces(
        self, frame: CodedFrame, smooth: NDArray[Any], unit_m: float, camera: Camera | None
    ) -> dict[str, float]:
        """Errors of normals and planes. smooth: (H, W) pixels with a distance in both frames, away from edges."""
        before, after = _fits(frame, NORMAL_PX)
        flat_before, flat_after = _fits(frame, PLANE_PX)
        whole = np.flatnonzero(cut(smooth, NORMAL_PX).all(axis=1))
        # The sensor's noise hides what deviates less from a plane.
        is_flat = flat_before.residuals <= self.params.noise_per_m * unit_m
        flat = np.flatnonzero(is_flat & cut(smooth, PLANE_PX).all(axis=1))
        offsets = np.abs(flat_after.distances() - flat_before.distances())[flat]
        return {
            "normal_error_deg": _mean_angle_deg(before, after, whole, camera),
            "plane_angle_deg": _mean_angle_deg(flat_before, flat_after, flat, camera),
            "plane_offset_mm": 1e3 * unit_m * _ratio(offsets.sum(), len(offsets)),
        }


def _fits(frame: CodedFrame, side_px: int) -> tuple[Patches, Patches]:
    """Planes of the patches of the original and of the decoded frame."""
    original = frame.original.cached(("depth_patches", side_px), lambda image: fit_patches(image, side_px))
    return original, fit_patches(frame.decoded, side_px)


def _mean_angle_deg(before: Patches, after: Patches, chosen: NDArray[Any], camera: Camera | None) -> float:
    """Mean angle between the normals of the chosen patches; NaN without a camera or patches."""
    if camera is None:
        return math.nan
    chords = np.linalg.norm(after.normals(camera) - before.normals(camera), axis=1)[chosen]
    angles = 2.0 * np.arcsin(np.minimum(chords / 2.0, 1.0))  # unlike an arc cosine, exactly 0 for equal normals
    return _ratio(np.degrees(angles).sum(), len(angles))


def _ratio(total: Any, count: Any) -> float:
    return float(total) / float(count) if count else math.nan


@compiled
def _compare(
    original: Any, decoded: Any, unknown: int, edges: Edges, tolerance: float, unit_m: float, noise_per_m: float
) -> tuple[NDArray[np.int64], NDArray[np.float64], float, int, int]:
    """Sums over the pixels of two (H, W) uint16 frames with a distance in both.

    Returns the number of pixels by error in steps, elsewhere and near edges, (2, 65536); sum of errors over distances
    and number of pixels in each range, (4, 2); sum of squares of errors over the sensor's noise, at most _GROSS each,
    with that for each pixel that has a distance in one frame only; number of flying pixels, which differ from every
    distance around them by more than `tolerance` times the smallest one; and number of pixels with a distance in one.
    """
    at_edge, near, far = edges
    counts, ranges = np.zeros((2, 65536), np.int64), np.zeros((len(RANGES_M) + 1, 2))
    squares, flying, changed = 0.0, 0, 0
    for row in range(original.shape[0]):
        for column in range(original.shape[1]):
            before, after = np.int64(original[row, column]), np.int64(decoded[row, column])
            if before == unknown or after == unknown:
                if before != after:
                    squares += _GROSS**2
                    changed += 1
                continue
            error, edge = abs(after - before), at_edge[row, column]
            counts[np.int64(edge), error] += 1
            distance_m = unit_m * before if before else unit_m
            ratio, at = error * unit_m / distance_m, 0
            for limit_m in RANGES_M:
                if distance_m >= limit_m:
                    at += 1
            ranges[at, 0] += ratio
            ranges[at, 1] += 1.0
            squares += min(ratio / distance_m / noise_per_m, _GROSS) ** 2
            if edge:
                nearest, farthest = np.int64(near[row, column]), np.int64(far[row, column])
                least = tolerance * nearest
                if error > least and abs(after - nearest) > least and abs(after - farthest) > least:
                    flying += 1
    return counts, ranges, squares, flying, changed

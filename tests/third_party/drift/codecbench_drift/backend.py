"""A SLAM backend of the simplest kind: the camera moves as the picture shifts, and nothing corrects the drift."""

import time
from collections.abc import Callable, Iterable

import cv2
import numpy as np
from pydantic import Field

from codecbench import (
    Camera,
    Frame,
    Image,
    Params,
    SlamBackend,
    SlamError,
    SlamRun,
    TrackedFrame,
    Trajectory,
    gray_from_image,
)


class DriftParams(Params):
    least_response: float = Field(default=0.05, ge=0, le=1, description="of phase correlation, else the frame is lost")


class Drift(SlamBackend[DriftParams]):
    name = "drift"
    version = "1"
    params_type = DriftParams
    architectures = frozenset({"cta"})

    def run(
        self,
        frames: Iterable[Frame],
        camera: Camera,
        *,
        seed: int,
        keyframe_image: Callable[[int], Image] | None = None,
    ) -> SlamRun:
        tracked: list[TrackedFrame] = []
        poses: list[np.ndarray] = []
        position, before = np.zeros(2), None
        for frame in frames:
            started = time.perf_counter()
            gray = gray_from_image(frame.image).astype(np.float32)
            shift_px, response = (0.0, 0.0), 1.0
            if before is not None:
                shift_px, response = cv2.phaseCorrelate(before, gray)
            before, found = gray, response >= self.params.least_response
            if found:
                position -= np.array(shift_px) / (camera.fx, camera.fy)  # in units of the scene's depth
                pose = np.eye(4)
                pose[:2, 3] = position
                poses.append(pose)
            elapsed_ms = 1e3 * (time.perf_counter() - started)
            state, reason = ("tracked", "") if found else ("lost", f"response {response:.3f}")
            tracked.append(TrackedFrame(frame.index, frame.timestamp_s, state, reason=reason, elapsed_ms=elapsed_ms))
        if not tracked:
            raise SlamError("drift got no frame")
        stamps_s = [frame.timestamp_s for frame in tracked if frame.state == "tracked"]
        trajectory = Trajectory(np.array(stamps_s), np.array(poses))
        return SlamRun(
            frames=tuple(tracked),
            trajectory=trajectory,
            trajectory_before_loops=trajectory,
            keyframe_indices=np.zeros(0, np.int64),
            points_world=np.zeros((0, 3)),
            loops=(),
            maps=1,
        )

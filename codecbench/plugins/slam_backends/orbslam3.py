"""The `orbslam3` backend: ORB-SLAM3 through the package pyorbslam3, in a child process.

Campos, Elvira, Rodriguez, Montiel, Tardos, "ORB-SLAM3", IEEE T-RO 37(6), 2021, doi:10.1109/TRO.2021.3075644. It is
threaded and never gives the same trajectory twice, so it is paced: the time between two frames is at least that between
their captures.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field

from codecbench.core.contracts.errors import SlamError, Unsupported
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import Camera, Frame
from codecbench.core.contracts.slam import SlamBackend, SlamRun, TrackedFrame
from codecbench.plugins.slam_backends.child_process import ChildProcess
from codecbench.plugins.slam_backends.orbslam3_output import PrintedEvents, TrackedPose, run_from_files
from codecbench.slam.places.vocabulary import Vocabulary

SYSTEM_LIBRARIES: Final = "libgl1 libegl1 libopengl0 libsm6 libice6 libx11-6 libxext6"
START_TIMEOUT_S: Final = 300.0
"""Reading the vocabulary takes seconds to a minute."""
SAVE_TIMEOUT_S: Final = 300.0
"""Shutting down waits for a running global bundle adjustment."""


class OrbSlam3Params(Params):
    """Set the ORB features and the pace of ORB-SLAM3.

    features: most ORB features in a frame. levels: pyramid levels. scale: ratio of two consecutive levels.
    slowdown: how many times slower than real time frames are fed; on a busy or slow machine, raise it until
    `slam_ms_per_frame` is below the frame interval. answer_timeout_s: longest time for one frame, in seconds, before
    the run counts as hung.
    """

    features: Annotated[int, Field(ge=100, le=10_000)] = 1000
    levels: Annotated[int, Field(ge=1, le=16)] = 8
    scale: Annotated[float, Field(gt=1.0, le=2.0)] = 1.2
    slowdown: Annotated[float, Field(ge=1.0, le=100.0)] = 1.0
    answer_timeout_s: Annotated[float, Field(gt=0.0)] = 60.0


class OrbSlam3(SlamBackend[OrbSlam3Params]):
    """Runs ORB-SLAM3, monocular, paced at the times of the frames, with codecbench's own vocabulary.

    It does not report map points nor the matched frame of a loop: `points_world` is empty, and a LoopEvent's matched
    frame is -1. The seed has no effect.
    """

    name = "orbslam3"
    version = "1"
    params_type = OrbSlam3Params
    architectures = frozenset({"cta"})

    def __init__(self, params: OrbSlam3Params) -> None:
        super().__init__(params)
        if importlib.util.find_spec("pyorbslam3") is None:
            raise Unsupported("slam backend orbslam3 needs pyorbslam3; run: pip install 'codecbench[orbslam3]'")

    def run(
        self,
        frames: Iterable[Frame],
        camera: Camera,
        *,
        seed: int,
        keyframe_image: Callable[[int], Image] | None = None,
    ) -> SlamRun:
        if keyframe_image is not None:
            raise SlamError("orbslam3 takes one image per frame; for analyze-then-compress use slam backend orb")
        if any(camera.distortion[5:]):
            raise SlamError("orbslam3 does not support a rational lens (k4, k5, k6); use slam backend orb")
        with tempfile.TemporaryDirectory(prefix="codecbench-orbslam3-") as name:
            return self._run(Path(name), iter(frames), camera)

    def _run(self, folder: Path, frames: Iterator[Frame], camera: Camera) -> SlamRun:
        vocabulary, settings, log = folder / "vocabulary.txt", folder / "settings.yaml", folder / "log.txt"
        Vocabulary.load_default().write_dbow2_text(vocabulary)
        command = [sys.executable, str(Path(__file__).with_name("orbslam3_child.py")), str(log)]
        states: list[TrackedFrame] = []
        poses: list[TrackedPose] = []
        with ChildProcess(command, log, "ORB-SLAM3") as child:
            events = PrintedEvents(log)
            first, frame_rate_hz = _peek(frames)
            settings.write_text(settings_text(camera, self.params, frame_rate_hz))
            self._start(child, vocabulary, settings)
            for frame in chain(first, frames):
                state, pose = self._track(child, frame, camera)
                states.append(state)
                poses.extend([] if pose is None else [pose])
                events.read(frame.index)
            child.send({"save": str(folder)})
            child.receive(SAVE_TIMEOUT_S, "saving trajectories")
            events.read(states[-1].index)
        return run_from_files(folder, states, poses, events)

    def _start(self, child: ChildProcess, vocabulary: Path, settings: Path) -> None:
        child.send({"vocabulary": str(vocabulary), "settings": str(settings), "slowdown": self.params.slowdown})
        answer = child.receive(START_TIMEOUT_S, "starting")
        if (why := answer.get("unavailable")) is not None:
            raise Unsupported(f"pyorbslam3 does not import ({why}); on Debian run: apt-get install {SYSTEM_LIBRARIES}")

    def _track(self, child: ChildProcess, frame: Frame, camera: Camera) -> tuple[TrackedFrame, TrackedPose | None]:
        gray = gray_from_image(frame.image)
        if gray.shape != (camera.height, camera.width):
            reason = f"the frame is {gray.shape[1]}x{gray.shape[0]}, the camera {camera.width}x{camera.height}"
            return TrackedFrame(frame.index, frame.timestamp_s, "refused", reason=reason), None
        child.send({"timestamp_s": frame.timestamp_s, "shape": gray.shape}, gray.tobytes())
        answer = child.receive(self.params.answer_timeout_s, f"frame {frame.index}")
        return read_answer(answer, frame)


def _peek(frames: Iterator[Frame]) -> tuple[list[Frame], float]:
    """The first two frames and their frame rate. Raises SlamError if there are fewer than two."""
    first = list(islice(frames, 2))
    if len(first) < 2:
        raise SlamError(f"orbslam3 got {len(first)} frame(s); it needs two for their rate")
    return first, 1.0 / (first[1].timestamp_s - first[0].timestamp_s)


def read_answer(answer: dict[str, Any], frame: Frame) -> tuple[TrackedFrame, TrackedPose | None]:
    """The state of a frame, and its pose if it is tracked, from the child's answer."""
    elapsed_ms = float(answer["elapsed_ms"])
    if answer["tracked"] and answer["state"].endswith(("OK", "OK_KLT")):
        state = TrackedFrame(frame.index, frame.timestamp_s, "tracked", answer["inliers"], elapsed_ms=elapsed_ms)
        return state, TrackedPose(frame.timestamp_s, answer["world_from_camera"])
    fresh = answer["state"].endswith(("NOT_INITIALIZED", "NO_IMAGES_YET", "SYSTEM_NOT_READY"))
    state = TrackedFrame(
        frame.index,
        frame.timestamp_s,
        "not_initialized" if fresh else "lost",
        reason=answer["state"].rpartition(".")[2].lower(),
        elapsed_ms=elapsed_ms,
    )
    return state, None


def settings_text(camera: Camera, params: OrbSlam3Params, frame_rate_hz: float) -> str:
    """ORB-SLAM3's settings file, in OpenCV's dialect of YAML."""
    is_fisheye = camera.model == "equidistant"
    values: dict[str, float | int | str] = {
        "File.version": '"1.0"',
        "Camera.type": '"KannalaBrandt8"' if is_fisheye else '"PinHole"',
        "Camera1.fx": camera.fx,
        "Camera1.fy": camera.fy,
        "Camera1.cx": camera.cx,
        "Camera1.cy": camera.cy,
        "Camera.width": camera.width,
        "Camera.height": camera.height,
        "Camera.fps": max(round(frame_rate_hz), 1),
        "Camera.RGB": 1,
        "ORBextractor.nFeatures": params.features,
        "ORBextractor.scaleFactor": params.scale,
        "ORBextractor.nLevels": params.levels,
        "ORBextractor.iniThFAST": 20,
        "ORBextractor.minThFAST": 7,
    }
    if is_fisheye:
        values |= {f"Camera1.k{number}": k for number, k in enumerate(camera.distortion[:4], start=1)}
    elif any(camera.distortion):
        k1, k2, p1, p2, k3 = camera.distortion[:5]
        values |= {"Camera1.k1": k1, "Camera1.k2": k2, "Camera1.p1": p1, "Camera1.p2": p2}
        values |= {"Camera1.k3": k3} if k3 else {}
    values |= {f"Viewer.{name}": value for name, value in _VIEWER.items()}
    lines = [f"{name}: {float(v)!r}" if isinstance(v, float) else f"{name}: {v}" for name, v in values.items()]
    return "%YAML:1.0\n" + "\n".join(lines) + "\n"


_VIEWER: Final[dict[str, float]] = {
    "KeyFrameSize": 0.05,
    "KeyFrameLineWidth": 1.0,
    "GraphLineWidth": 0.9,
    "PointSize": 2.0,
    "CameraSize": 0.08,
    "CameraLineWidth": 3.0,
    "ViewpointX": 0.0,
    "ViewpointY": -0.7,
    "ViewpointZ": -1.8,
    "ViewpointF": 500.0,
}
"""Settings of the viewer, which the file must have although nothing is shown."""

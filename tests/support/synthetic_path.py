"""Camera paths with known answers, and a SLAM backend that returns what it was told to."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import NoParams
from codecbench.core.contracts.sequence import Camera, Frame, Trajectory
from codecbench.core.contracts.slam import LoopEvent, SlamBackend, SlamRun, TrackedFrame

CAMERA = Camera(8, 6, 5.0, 5.0, 3.5, 2.5)


def helix(count: int, rate_hz: float = 10.0) -> Trajectory:
    """A camera that climbs a spiral and looks about."""
    turn = np.linspace(0.0, 6.0, count)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = np.column_stack([np.cos(turn), np.sin(turn), 0.2 * turn])
    poses[:, :3, :3] = Rotation.from_euler("zyx", np.column_stack([turn, 0.3 * np.sin(turn), 0.1 * turn])).as_matrix()
    return Trajectory(np.arange(count) / rate_hz, poses)


def moved(path: Trajectory, scale: float = 0.3, turn: float = 1.1) -> Trajectory:
    """The same path in a map's own frame and unit."""
    rotation = Rotation.from_rotvec([0.3, turn, -0.5]).as_matrix()
    poses = path.world_from_camera.copy()
    poses[:, :3, :3] = rotation @ poses[:, :3, :3]
    poses[:, :3, 3] = scale * poses[:, :3, 3] @ rotation.T + [3.0, -2.0, 0.5]
    return Trajectory(path.timestamps_s, poses)


def noisy(path: Trajectory, sigma_m: float, seed: int = 3) -> Trajectory:
    """The path with Gaussian noise on each coordinate of its positions."""
    poses = path.world_from_camera.copy()
    poses[:, :3, 3] += np.random.default_rng(seed).normal(0.0, sigma_m, (len(path), 3))
    return Trajectory(path.timestamps_s, poses)


def part(path: Trajectory, positions: Any) -> Trajectory:
    return Trajectory(path.timestamps_s[positions], path.world_from_camera[positions])


class Told(SlamBackend[NoParams]):
    """Looks at every frame and returns the trajectory that it was given."""

    name = "told"
    version = "1"
    params_type = NoParams
    architectures = frozenset({"cta", "atc"})

    def __init__(self, answer: Trajectory, before: Trajectory | None = None, loops: tuple[LoopEvent, ...] = ()) -> None:
        super().__init__(NoParams())
        self.answer, self.before, self.loops = answer, before or answer, loops
        self.keyframe_every = 5
        self.seen: list[Frame] = []
        self.keyframe_images: list[Image] = []
        self.seeds: list[int] = []

    def run(
        self,
        frames: Iterable[Frame],
        camera: Camera,
        *,
        seed: int,
        keyframe_image: Callable[[int], Image] | None = None,
    ) -> SlamRun:
        self.seen, self.keyframe_images = list(frames), []
        self.seeds.append(seed)
        tracked = set(self.answer.timestamps_s.tolist())
        states = []
        for frame in self.seen:
            keyframe = frame.timestamp_s in tracked and frame.index % self.keyframe_every == 0
            if keyframe and keyframe_image is not None:
                self.keyframe_images.append(keyframe_image(frame.index))
            state = "tracked" if frame.timestamp_s in tracked else "lost"
            states.append(TrackedFrame(frame.index, frame.timestamp_s, state, 50, keyframe, elapsed_ms=2.0))
        given = {frame.timestamp_s for frame in self.seen}
        kept = np.array([stamp in given for stamp in self.answer.timestamps_s.tolist()], dtype=bool)
        return SlamRun(
            frames=tuple(states),
            trajectory=part(self.answer, kept),
            trajectory_before_loops=part(self.before, kept),
            keyframe_indices=np.array([state.index for state in states if state.keyframe], dtype=np.int64),
            points_world=np.arange(12.0).reshape(4, 3),
            loops=self.loops,
            maps=1,
        )

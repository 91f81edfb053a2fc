"""The tables of docs/slam.md about cameras that see nothing for a while, and about frames that a link spoils.

python tests/benchmarks/slam_faults.py OFFICE

OFFICE is TUM's freiburg3_long_office_household in the layout of TUM. A row of the first table and a cell of the second
is one SLAM that is shown frames, in gray.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from slam_runs import error_m, path_of, system_of

from codecbench import slam
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.sequence import FrameSequence, Trajectory
from codecbench.core.report.tables import table
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.tum import Tum
from codecbench.plugins.evaluators.trajectory.alignment import associate

RATE_HZ: Final = 30.0
GAPS: Final = ("sequence", "black", "seen again", "maps, merged", "tracked %", "error, mm", "without the gap")
WORLDS: Final = ("room", "corridor_loop", "street", "field")
FAULTS: Final = ("fault", "office", *WORLDS)
_ASSOCIATION_S: Final = 0.02
_BURSTS: Final = (0.30, 0.55, 0.80)
"""Where on the way they begin."""
_EXPOSURES: Final = (0.6, 1.0, 1.5, 0.8, 1.3)
"""Factors on the exposure time, one a second."""


@dataclass(frozen=True)
class Shown:
    """A frame as SLAM is shown it: which one of the sequence, when in seconds, how bright, or black."""

    index: int
    time_s: float
    gain: float = 1.0
    black: bool = False


ShownFrames = list[Shown]
"""What one SLAM is shown."""


def course(indices: list[int], rate_hz: float = RATE_HZ) -> ShownFrames:
    """Frames in this order, one after another at the rate of the camera."""
    return [Shown(index, place / rate_hz) for place, index in enumerate(indices)]


def blackened(frames: ShownFrames, first: int, last: int) -> ShownFrames:
    """The frames with those from place `first` to `last` black."""
    return [replace(frame, black=first <= place <= last) for place, frame in enumerate(frames)]


def in_two_parts(one: range, other: range, black: int) -> tuple[ShownFrames, ShownFrames]:
    """The frames of two parts of a sequence with so many black ones between them, and without."""
    gap = [one[-1]] * black
    return blackened(course([*one, *gap, *other]), len(one), len(one) + black - 1), course([*one, *other])


def in_bursts(frames: ShownFrames, seconds: float) -> list[bool]:
    """Which frames lie in one of three bursts of this length."""
    starts = [round(share * len(frames)) for share in _BURSTS]
    length = round(seconds / interval_s(frames))
    return [any(start <= place < start + length for start in starts) for place in range(len(frames))]


def interval_s(frames: ShownFrames) -> float:
    """Seconds between two frames of a course."""
    return frames[1].time_s - frames[0].time_s


def faults(frames: ShownFrames) -> Iterator[tuple[str, ShownFrames]]:
    """Each fault of the table with what is left to show, drawn at random from a fixed seed."""

    def kept(share: float) -> ShownFrames:
        there = np.random.default_rng(0).random(len(frames)) >= share
        return [frame for frame, present in zip(frames, there, strict=True) if present]

    yield "none", frames
    yield "10 % of the frames missing, at random", kept(0.1)
    yield "30 % missing", kept(0.3)
    for seconds in (0.5, 1, 2):
        spoilt = in_bursts(frames, seconds)
        there = zip(frames, spoilt, strict=True)
        yield f"three bursts of {seconds:g} s missing", [frame for frame, bad in there if not bad]
        black = [replace(frame, black=bad) for frame, bad in zip(frames, spoilt, strict=True)]
        yield f"three bursts of {seconds:g} s black", black
    again = np.random.default_rng(0).random(len(frames)) < 0.2
    again[0] = False
    repeated = [replace(f, index=f.index - 1) if twice else f for f, twice in zip(frames, again, strict=True)]
    yield "20 % are the frame before once more", repeated
    late = np.random.default_rng(0).uniform(0.0, 0.9, len(frames)) * interval_s(frames)
    times = zip(frames, late.tolist(), strict=True)
    yield "time stamps late by up to 0.9 frames, at random", [replace(f, time_s=f.time_s + by) for f, by in times]
    exposed = [replace(f, gain=_EXPOSURES[int(f.time_s) % len(_EXPOSURES)]) for f in frames]
    yield f"exposure times {', '.join(f'{gain:g}' for gain in _EXPOSURES)}, a second each", exposed


@dataclass(frozen=True)
class Outcome:
    """What became of a course. tracked: percent of the frames with a picture, from the first map on, that the largest
    map holds. error_mm: RMS distance of these from where the camera was when it took them, after alignment."""

    result: slam.Result
    tracked: float
    error_mm: float

    @property
    def seen_again(self) -> str:
        """Where the way from before the gap was found."""
        if self.result.merges:
            return f"at frame {self.result.merges[0].frame_index}"
        return "in the first map" if len(self.result.maps) == 1 else "never"


class Film:
    """A sequence in memory."""

    def __init__(self, sequence: FrameSequence) -> None:
        self.sequence = sequence
        self._frames: dict[int, Image] = {}

    def __len__(self) -> int:
        return len(self.sequence)

    @property
    def rate_hz(self) -> float:
        """Of the camera: the nearest multiple of 5 Hz, because recordings waver."""
        return 5.0 * round(0.2 / float(np.median(np.diff(self.sequence.timestamps_s))))

    def frame(self, shown: Shown) -> Image:
        if shown.index not in self._frames:
            self._frames[shown.index] = gray_from_image(self.sequence.read(shown.index).image)
        frame = self._frames[shown.index]
        if shown.black:
            return np.zeros_like(frame)
        return frame if shown.gain == 1.0 else np.clip(frame * shown.gain + 0.5, 0, 255).astype(np.uint8)

    @cached_property
    def poses(self) -> dict[float, np.ndarray]:
        """The true pose of each frame that has one, by its time stamp."""
        assert self.sequence.ground_truth is not None
        stamps = self.sequence.timestamps_s
        none = Trajectory(stamps, np.tile(np.eye(4), (len(stamps), 1, 1)))
        pairs = associate(none, self.sequence.ground_truth, _ASSOCIATION_S)
        return dict(zip(pairs.estimate.timestamps_s.tolist(), pairs.reference.world_from_camera, strict=True))

    def truth(self, frames: ShownFrames) -> Trajectory:
        """Where the camera was when it took what is shown, at the times at which it is shown."""
        stamps = self.sequence.timestamps_s
        known = [(frame.time_s, self.poses.get(float(stamps[frame.index]))) for frame in frames if not frame.black]
        present = [(time_s, pose) for time_s, pose in known if pose is not None]
        return Trajectory(np.array([time_s for time_s, _ in present]), np.array([pose for _, pose in present]))

    def outcome(self, frames: ShownFrames) -> Outcome:
        """What SLAM makes of them."""
        system = system_of(self.sequence)
        for shown in frames:
            system.process(self.frame(shown), shown.time_s)
        result = system.finish()
        first = next((state.index for state in result.frames if state.state == "tracked"), len(frames))
        with_picture = sum(not frame.black for frame in frames[first:])
        error_mm = 1e3 * error_m(path_of(result), self.truth(frames), 0.0)
        return Outcome(result, 100.0 * len(result.trajectory) / max(with_picture, 1), error_mm)


def gap_rows(room: Film, office: Film) -> Iterator[list[object]]:
    """Four seconds without a picture, one row a course."""
    for name, film, spans in (
        ("room", room, ((60, 179), (120, 239), (100, 279), (180, 299))),
        ("office", office, ((200, 319), (300, 419), (400, 519), (500, 619))),
    ):
        whole = course(list(range(len(film))))
        without = film.outcome(whole)
        for first, last in spans:
            title = f"{name}, {len(film)} frames"
            yield gap_row(title, f"{first}-{last}", film.outcome(blackened(whole, first, last)), without)
    for one, other in ((range(250, 500), range(500)), (range(350, 715), range(600))):
        black, without_gap = in_two_parts(one, other, 120)
        title = f"office, frames {one[0]}-{one[-1]}, then {other[0]}-{other[-1]}"
        yield gap_row(title, "between the two", office.outcome(black), office.outcome(without_gap))


def gap_row(title: str, black: str, with_gap: Outcome, without: Outcome) -> list[object]:
    result = with_gap.result
    maps = f"{len(result.maps)}, {len(result.merges)}"
    error, before = (f"{outcome.error_mm:.1f}" for outcome in (with_gap, without))
    return [title, black, with_gap.seen_again, maps, f"{with_gap.tracked:.1f}", error, before]


def fault_rows(films: list[Film]) -> Iterator[list[object]]:
    """The frames of each film spoilt, one row a fault."""
    spoilt = [faults(course(list(range(len(film))), film.rate_hz)) for film in films]
    for each in zip(*spoilt, strict=True):
        cells = [fault_cell(film.outcome(frames)) for film, (_, frames) in zip(films, each, strict=True)]
        yield [each[0][0], *cells]


def fault_cell(found: Outcome) -> str:
    maps = len(found.result.maps)
    return f"{found.tracked:.1f} %, {found.error_mm:.1f} mm" + (f", {maps} maps" if maps > 1 else "")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("office", type=Path)
    office = Film(Tum.create(path=str(parser.parse_args().office)).open())
    worlds = [Film(Synthetic.create(world=name).open()) for name in WORLDS]
    printed: tuple[Callable[[], str], ...] = (
        lambda: table(GAPS, gap_rows(Film(Synthetic.create().open()), office)),
        lambda: table(FAULTS, fault_rows([office, *worlds])),
    )
    for one in printed:
        print(one())


if __name__ == "__main__":
    main()

"""The table of docs/pictures-or-features.md: SLAM on decoded pictures beside SLAM on decoded features, by rate.

python docs/feature_tables.py FOLDER [--frames N] [--starts 0 10 20] [--times]

FOLDER is in the layout of TUM. All see the frames in gray. Errors are medians over runs that start at these frames.
`docs/tables.py --printed features=FILE` puts what this prints without --times into the page.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from run_tables import CODING, SETTING, Column, machine, rows_of
from slam_runs import error_m, path_of, system_of

from codecbench import slam
from codecbench.core.analysis.ranking import rankings
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.contracts.codec import AnyCodec, decoder_of, encoder_of
from codecbench.core.contracts.features import Features
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.sequence import FrameSequence, Trajectory
from codecbench.core.engine.registry import installed
from codecbench.core.report.formatting import signed_percent
from codecbench.core.report.tables import table
from codecbench.plugins.codecs.orb_features.codec import OrbFeatures
from codecbench.plugins.datasets.tum import Tum
from codecbench.plugins.slam_backends.keypoints import keypoints_of

PICTURES: Final[tuple[tuple[str, dict[str, Any]], ...]] = (
    ("raw", {}),
    *(("jpeg", {"quality": quality}) for quality in (3, 5, 10, 20, 40)),
    *(("jpeg2000", {"ratio": ratio}) for ratio in (200, 80, 40, 20)),
    *(("multilevel", {"profile": "context", "qf": qf}) for qf in (1.5, 3.0, 6.0, 12.0)),
    *(("h264", {"crf": crf}) for crf in (20, 26, 32, 38)),
)
"""Those that are not installed are left out."""
FEATURES: Final[tuple[dict[str, Any], ...]] = (
    {"descriptor": "raw"},
    {},
    {"mode": "inter"},
    {"mode": "inter", "angle_bits": 10},
    {"mode": "inter", "angle_bits": 6, "descriptor": "lossy"},
    {"mode": "inter", "angle_bits": 8, "descriptor": "lossy", "position_step_px": 2},
    {"mode": "inter", "angle_bits": 8, "descriptor": "lossy", "position_step_px": 2, "features": 500},
    {"mode": "inter", "angle_bits": 8, "descriptor": "lossy", "position_step_px": 2, "features": 250},
)
HEADS: Final = ("sent", "bytes a frame", "bit/pixel", "bytes a feature", "tracked", "ATE mm", "as raw")
TIMES: Final = ("extract ms", "encode ms", "decode ms")
TASKS: Final = {
    "bit/px": CODING["bit/px"],
    "localisation AUC": Column("localization.located_auc.mean"),
    "map points found": Column("localization.tracked_inliers.mean"),
    "held mm": Column("trajectory.held_ate_m.median", 1e3),
    "ATE mm": Column("trajectory.ate_rmse_m.median", 1e3),
    "device ms": Column("timing.encode_cpu_ms.median"),
    "of which extracting": Column("timing.encode_cpu_ms.encode/extract.median"),
    "server ms": Column("timing.decode_cpu_ms.median"),
}
"""Of a run of examples/features.yaml."""
_FRAME_RATE_HZ: Final = 30.0


@dataclass
class Sent:
    """What came of one setting: what SLAM gets of each frame, its bytes, and the milliseconds of each step.

    features: how many SLAM has of a frame.
    """

    title: str
    features: int = 1000
    received: list[Image | Features] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    steps_ms: dict[str, list[float]] = field(default_factory=lambda: {head: [] for head in TIMES})

    def timed(self, step: str, function: Callable[[], Any]) -> Any:
        """What a function returns."""
        started = time.perf_counter()
        value = function()
        self.steps_ms[step].append(1e3 * (time.perf_counter() - started))
        return value


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--starts", type=int, nargs="+", default=[0, 10, 20])
    parser.add_argument("--times", action="store_true", help="also what each step takes, on a quiet machine")
    arguments = parser.parse_args()
    sequence = Tum.create(path=str(arguments.folder)).open()
    frames = [gray_from_image(sequence.read(index).image) for index in range(min(arguments.frames, len(sequence)))]
    heads = (*HEADS, *TIMES) if arguments.times else HEADS
    print(table(heads, rows(sequence, frames, arguments.starts, arguments.times)))


def every_setting(run: RunResult, heads: tuple[str, ...]) -> Iterator[str]:
    """Rate and tasks of every setting of a run, for docs/tables.py."""
    (sequence,) = run.plan.sequences
    yield f"{sequence.frames} frames at 30 Hz, processor time a frame on one core of a shared {machine(run)}:\n"
    yield table(
        heads,
        [
            [row[head] if head in SETTING else TASKS[head].shown(row) for head in heads]
            for row in rows_of(run, sequence.name)
        ],
    )


def answer(run: RunResult, heads: tuple[str, ...]) -> Iterator[str]:
    """How much more or less rate than JPEG each codec takes for equal localization, by rate; of several settings."""
    ranking = next(found for found in rankings(run) if found.column.name == "localization.located_auc.mean")
    (sequence,) = run.plan.sequences
    rows = []
    for ranked in ranking.ranked:
        found = ranking.evidence(ranked.curve, "jpeg")
        if found and len(ranked.settings[sequence.name]) > 1:
            better = "yes" if "jpeg" in ranked.ahead_of else "not shown"
            rows.append([f"`{ranked.curve.partition(' ')[0]}`", signed_percent(found), better])
    yield f"Rate vs. JPEG for equal localization, {ranking.units} frames of the {sequence.name} (TUM RGB-D):\n"
    yield table(heads, rows)


def rows(sequence: FrameSequence, frames: list[Image], starts: list[int], times: bool) -> Iterator[list[object]]:
    """One for each setting. The first is raw, whose paths the others' are compared with."""
    raw: list[Trajectory] = []
    for setting in settings(frames):
        paths = [path(sequence, setting, start) for start in starts]
        raw = raw or paths
        same = all(np.array_equal(a.world_from_camera, b.world_from_camera) for a, b in zip(paths, raw, strict=True))
        size, pixels = float(np.mean(setting.sizes)), frames[0].size
        row: list[object] = [setting.title, round(size), 8.0 * size / pixels]
        row.append(sum(setting.sizes) / sum(setting.counts) if setting.counts else None)
        row.append(f"{100.0 * np.mean([len(p) / (len(frames) - s) for p, s in zip(paths, starts, strict=True)]):.0f} %")
        row += [
            1e3 * float(np.median([error_m(found, sequence.ground_truth) for found in paths])),
            "to the bit" if same else "–",
        ]
        if times:
            row += [float(np.median(taken)) if taken else None for taken in setting.steps_ms.values()]
        yield row


def settings(frames: list[Image]) -> Iterator[Sent]:
    """Every setting, with what is received of the frames."""
    for name, params in PICTURES:
        if installed().find("codec", name).missing is None:
            yield pictures(installed().create("codec", name, params), title(name, params), frames)
    for params in FEATURES:
        yield features(OrbFeatures.create(**params), title(OrbFeatures.name, params), frames)


def title(name: str, params: dict[str, Any]) -> str:
    """A setting as the table names it."""
    return " ".join([f"`{name}`", ", ".join(f"{key}={value}" for key, value in params.items())]).strip()


def pictures(codec: AnyCodec[Any], name: str, frames: list[Image]) -> Sent:
    """Frames encoded and decoded in order, each at once."""
    sent, encoder, decoder = Sent(name), encoder_of(codec, _FRAME_RATE_HZ), decoder_of(codec)
    for frame in frames:
        (packet,) = sent.timed("encode ms", lambda frame=frame: encoder.push(frame))
        (picture,) = sent.timed("decode ms", lambda packet=packet: decoder.push(packet))
        sent.received.append(picture.image)
        sent.sizes.append(len(packet.data))
    return sent


def features(codec: OrbFeatures, name: str, frames: list[Image]) -> Sent:
    """Features extracted from frames, encoded and decoded in order."""
    sent, encoder, decoder = Sent(name, codec.params.features), codec.encoder(), codec.decoder()
    for frame in frames:
        found = sent.timed("extract ms", lambda frame=frame: codec.extract(frame))
        packet = sent.timed("encode ms", lambda found=found: encoder.push(found))
        back = sent.timed("decode ms", lambda packet=packet: decoder.push(packet))
        sent.received.append(back.features)
        sent.sizes.append(len(packet.data))
        sent.counts.append(len(found))
    return sent


def path(sequence: FrameSequence, sent: Sent, start: int) -> Trajectory:
    """The path that SLAM finds from a frame on."""
    system = system_of(sequence, slam.Options(features=sent.features))
    for frame, stamp_s in zip(sent.received[start:], sequence.timestamps_s[start:].tolist(), strict=False):
        if isinstance(frame, Features):
            system.process_keypoints(keypoints_of(frame), stamp_s)
        else:
            system.process(frame, stamp_s)
    return path_of(system.finish())


if __name__ == "__main__":
    main()

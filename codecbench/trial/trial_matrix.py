"""The text of a matrix that suits a recording, with comments, to run, edit and run again."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count, islice
from typing import Any, Final, Literal

from codecbench.core.contracts.codec import StreamCodec
from codecbench.core.contracts.errors import CodecbenchError, Unsupported
from codecbench.core.engine.planning.estimate import START_S, estimate
from codecbench.core.engine.planning.matrix import matrix_from
from codecbench.core.engine.planning.model import Plan, SequenceEntry
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.planning.search import ALL_REPEATS, PlanScope
from codecbench.core.engine.planning.search_section import PASSES
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.running.warm_up import kernels_to_compile
from codecbench.core.engine.text import counted
from codecbench.trial.pace import Pace, measure_pace
from codecbench.trial.recording import Recording
from codecbench.trial.requested_codecs import RequestedCodec, parse_codec

Purpose = Literal["tracking", "quality", "speed", "depth"]

_USUAL: Final = ("jpeg:1..95", "h264:crf=51..15", "webp:0..95", "jpeg2000:ratio=400..4")
"""Default codecs, each from coarse to fine. The last ones are left out first if time is short."""
_USUAL_16_BITS: Final = ("jpegxl:distance=0", "png", "jpeg2000:ratio=100..2")
_USUAL_DEPTH: Final = (
    "rvl", "png", "jpegxl:distance=0,effort=1|2|4", "lerc:max_error=64..0", "zstd", "ffv1", "hevc:crf=40..0",
)  # fmt: skip
_STEPS: Final = {False: 15, True: 7}
"""Steps of a range; True: if each needs several runs. One less than a power of 2, as bisection halves them."""
_STARTS: Final = (0, 1, 2, 3)
"""Start offsets of SLAM; a success rate needs at least four runs."""
_TYPICAL_PIXELS: Final = 640 * 480
_FEWEST: Final[dict[str, int]] = {"tracking": 150, "quality": 10, "speed": 10, "depth": 10}
"""Minimum number of frames for each aim: SLAM needs a few seconds of a recording to begin a map."""
_FEWEST_FOR_VIDEO: Final = 60
"""Minimum number of frames for video codecs: with fewer, the first frame dominates the rate."""
_MARGIN: Final = 1.4
"""Factor on typical costs, so that searches finish even if frames cost more than typical ones."""
_ROUND_S: Final = 3.0
"""Overhead of a round of trials: workers wait for the last cell, and tables are made."""
_MINUTES: Final[dict[str, float]] = {"tracking": 5.0, "quality": 2.5, "speed": 2.5, "depth": 2.5}
"""Default time for each aim; SLAM from several start offsets takes longest."""


@dataclass(frozen=True)
class TrialMatrix:
    """The text of a matrix, and how it was chosen."""

    text: str
    aim: Purpose
    frames: int
    settings: int
    """Approximate number of settings that will be tried."""
    estimated_s: float
    """Wall time on this machine as busy as it is now."""
    compiles: bool
    """Whether `estimated_s` contains the compilation of kernels that the cache lacks."""
    choices: tuple[str, ...]
    """The choices in words, for the user."""

    @property
    def minutes(self) -> int:
        """The announced duration in minutes."""
        return max(1, round(self.estimated_s / 60.0 + 0.2))

    @property
    def most_minutes(self) -> float:
        """Time after which no new trial begins: the announced duration and a tenth more."""
        return 1.1 * self.minutes


def suited_aim(recording: Recording) -> Purpose:
    """Return `depth` for depth, `speed` for other 16-bit frames, `tracking` if SLAM can run, else `quality`."""
    if recording.depth_unit_m is not None:
        return "depth"
    if recording.bits != 8:
        return "speed"
    return "tracking" if recording.has_camera and recording.frames >= _FEWEST["tracking"] else "quality"


def trial_matrix(
    registry: Registry,
    recording: Recording,
    codecs: Sequence[str] = (),
    aim: Purpose | None = None,
    minutes: float | None = None,
) -> TrialMatrix:
    """Return a matrix for as many frames of a recording as fit into the expected `minutes`.

    codecs: as `parse_codec` reads them; by default common ones that are installed. aim: by default what suits the
    recording. minutes: by default 5 for tracking, else 2.5. Raises Unsupported if the aim needs a camera that is not
    known, ParamsError and MatrixError.
    """
    chosen: list[str] = []
    if aim is None:
        aim = suited_aim(recording)
        chosen.append(_explain_aim(aim, recording))
    minutes = _MINUTES[aim] if minutes is None else minutes
    if (aim == "depth") != (recording.depth_unit_m is not None):
        is_not = "is not depth" if aim == "depth" else "is depth: PSNR, features and SLAM say nothing of it"
        raise Unsupported(f"--for {aim}: this recording {is_not}; use --for {suited_aim(recording)}")
    if aim in ("tracking", "quality") and recording.bits != 8:
        raise Unsupported(f"--for {aim}: SLAM and features read 8-bit frames, and these have 16; use --for speed")
    if aim == "tracking" and not recording.has_camera:
        raise Unsupported(
            "tracking needs the camera, and this recording has no calibration; give --fov DEGREES (its horizontal "
            "field of view), or a calibration file in a matrix of your own (codecbench init), or --for quality"
        )
    if aim == "tracking" and not recording.has_ground_truth:
        chosen.append(
            "there is no ground truth: SLAM trajectories on raw frames are the reference, as far as they agree"
        )
    if recording.sizes and not codecs:
        names = ", ".join(text.partition(":")[0] for text in _defaults(recording) if _is_video_codec(registry, text))
        chosen.append(f"video codecs ({names}) are left out: they need frames of one size")
    draft = _fit_to_time(registry, recording, list(codecs), aim, minutes, chosen)
    settings = len({cell.codec for cell in draft.plan.cells})
    compiles = draft.pace.compiling_s > 0.0
    return TrialMatrix(draft.text(), aim, draft.frames, settings, draft.seconds, compiles, tuple(chosen))


def _fit_to_time(
    registry: Registry, recording: Recording, codecs: list[str], aim: Purpose, minutes: float, chosen: list[str]
) -> _Draft:
    """Return the matrix that is expected to fit into `minutes`; adds to `chosen` which codecs and frames it drops."""
    texts = codecs or _usual(registry, recording)
    fewest = max(_FEWEST[aim], *(_FEWEST_FOR_VIDEO * _is_video_codec(registry, text) for text in texts))
    budget_s = 60.0 * minutes
    steps = _STEPS[aim == "tracking" and not recording.has_ground_truth]
    pace = measure_pace(registry, recording)

    def make_draft() -> _Draft:
        requested = tuple(parse_codec(registry, text, steps) for text in texts)
        return _Draft(registry, recording, requested, aim, min(fewest, recording.frames), pace)

    pace = replace(pace, compiling_s=kernels_to_compile(make_draft().plan.cells, registry).seconds)
    draft = make_draft()
    left_out: list[str] = []
    while not codecs and len(texts) > 2 and draft.seconds > budget_s:
        left_out.append(texts.pop().partition(":")[0])
        draft = make_draft()
    if left_out:
        chosen.append(f"left out to save time (--minutes): {', '.join(left_out)}")
    about = f"about {minutes:g} minute{'' if minutes == 1 else 's'} (--minutes)"
    if draft.seconds > budget_s:
        which = f"the first {draft.frames:,} of" if draft.frames < recording.frames else "all"
        total = counted(recording.frames, "frame")
        chosen.append(f"{which} {total} are needed, which may take more than {about}")
        return draft
    whole = replace(draft, frames=recording.frames)
    if whole.seconds <= budget_s:
        return whole
    share = (budget_s - draft.seconds) / (whole.seconds - draft.seconds)
    draft = replace(draft, frames=draft.frames + int(share * (recording.frames - draft.frames)))
    chosen.append(
        f"the first {draft.frames:,} of {counted(recording.frames, 'frame')}, to finish in {about}; "
        f"the other frames are not used"
    )
    return draft


def _explain_aim(aim: Purpose, recording: Recording) -> str:
    """Explain the aim; if one parameter would make it tracking, say which."""
    if aim == "depth":
        return "the pixels are distances, so codecs are judged by their errors against the sensor's noise (--for depth)"
    if recording.bits != 8:
        how = "; if they are distances: --set depth_unit_m=METERS" if "depth_unit_m" in recording.settable else ""
        means = "PSNR, whose 40 dB are an error of 655 steps, and by times (--for speed)"
        return f"frames of 16 bits are not for SLAM or features, so codecs are judged by {means}{how}"
    if aim == "tracking":
        return "the camera is known, so codecs are judged by SLAM on their frames (--for tracking)"
    judgment = "so codecs are judged by image quality and features (--for quality)"
    if recording.has_camera:
        verb = "is" if recording.frames == 1 else "are"
        return f"{counted(recording.frames, 'frame')} {verb} too few for SLAM, {judgment}"
    enough = recording.frames >= _FEWEST["tracking"] and not recording.sizes and "fov_deg" in recording.settable
    how = "; with --fov DEGREES, the horizontal field of view, SLAM can run" if enough else ""
    return f"the camera is not known, {judgment}{how}"


def _usual(registry: Registry, recording: Recording) -> list[str]:
    """Return the default codecs that are installed and can code the recording's frames."""
    available = [
        text for text in _defaults(recording) if registry.find("codec", text.partition(":")[0]).missing is None
    ]
    return [text for text in available if not (recording.sizes and _is_video_codec(registry, text))]


def _defaults(recording: Recording) -> tuple[str, ...]:
    """Return the default codecs for a recording's pixels."""
    if recording.depth_unit_m is not None:
        return _USUAL_DEPTH
    return _USUAL_16_BITS if recording.bits == 16 else _USUAL


def _is_video_codec(registry: Registry, text: str) -> bool:
    name = text.partition(":")[0]
    return issubclass(registry.load("codec", name), StreamCodec)


@dataclass(frozen=True)
class _Draft:
    """A matrix for a number of frames, with its expected cost."""

    registry: Registry
    recording: Recording
    codecs: tuple[RequestedCodec, ...]
    aim: Purpose
    frames: int
    pace: Pace

    @cached_property
    def plan(self) -> Plan:
        """The expected work: of a search as many settings as bisection tries, and the most costly of them."""
        matrix, recording = matrix_from(self.text(), self.registry), self.recording
        entry = SequenceEntry(
            recording.name, matrix.sequences[0].setting, "", self.frames, recording.channels, recording.has_camera,
            recording.has_ground_truth, bits=recording.bits, has_depth=recording.depth_unit_m is not None,
        )  # fmt: skip
        titles = [evaluator.setting.title for evaluator in matrix.evaluators]
        repeated = {"trajectory"} if titles == ["quality", "trajectory", "timing"] else set(titles) - {"trajectory"}
        repeats = {
            (entry.name, setting, title): ALL_REPEATS
            for search in matrix.searches
            for place, setting in enumerate(search.settings[: _tries(len(search.settings))])
            for title in titles
            if place == 0 or title == "quality" or (title in repeated and title != "timing")
        }
        return make_plan(matrix, self.registry, scope=PlanScope(repeats), sequences=[entry])

    @cached_property
    def seconds(self) -> float:
        """Expected duration in seconds. Typical costs are for frames of 640x480."""
        plan = self.plan
        cells = [cell for cell in plan.cells if cell.unsupported is None]
        if not cells:
            reasons = "; ".join(dict.fromkeys(str(cell.unsupported) for cell in plan.cells))
            raise CodecbenchError(f"no cell can run here: {reasons}")
        pixels = max(self.recording.width * self.recording.height / _TYPICAL_PIXELS, 0.2)
        typical_s = estimate(plan, cells, len(plan.jobs), {}).seconds - START_S
        reads = self.frames * (len(plan.jobs) + sum(not cell.exclusive for cell in cells))
        rounds = 3 + max((_tries(len(codec)) for codec in self.codecs if codec.searched), default=0)
        reading_s = reads * self.pace.reading_ms / 1e3 / plan.run.workers
        working_s = START_S + _ROUND_S * rounds + typical_s * pixels + reading_s
        return self.pace.slowness * (_MARGIN * working_s + self.pace.compiling_s / plan.run.workers)

    @property
    def _stop(self) -> int:
        """Number, in the source, of the frame after the last used one."""
        params = self.recording.params
        left_out = set(params.get("skip", ()))
        numbers = (
            number
            for number in count(int(params.get("start", 0)), int(params.get("stride", 1)))
            if number not in left_out
        )
        return next(islice(numbers, self.frames - 1, None)) + 1

    def text(self) -> str:
        """Return the YAML text."""
        recording = self.recording
        params = {**recording.params, **({"stop": self._stop} if self.frames < recording.frames else {})}
        lines = [
            "# What codecbench chose for this recording. Edit it and run it again: codecbench run FILE --out RUN",
            f"# {recording}",
            "version: 1",
            f"name: {_name(recording.name)}",
            "sequences:",
            f"  - use: {recording.dataset}",
            f"    params: {_flow(params)}",
            "codecs:",
            "  - raw  # uncompressed frames, the baseline of every task",
        ]
        for codec in self.codecs:
            lines.append(f"  - use: {codec.name}")
            if codec.searched:
                lines.append(f"    search: {PASSES}  # find the coarsest that passes; without this line all are run")
            if codec.values:
                lines.append(f"    params: {_flow({key: _values(span) for key, span in codec.values.items()})}")
        without_truth = self.aim == "tracking" and not recording.has_ground_truth
        lines += ["evaluators:", *(line for line in _EVALUATORS[self.aim] if not (without_truth and line == _PLACES))]
        return "\n".join(lines) + "\n"


_QUALITY: Final = "  - quality  # bits per pixel, PSNR, SSIM"
_PLACES: Final = "  - localization  # poses of frames in a map of raw frames"


def _tries(settings: int) -> int:
    """Return how many settings of an axis a bisection tries."""
    return settings.bit_length()


_EVALUATORS: Final[dict[str, list[str]]] = {
    "tracking": [
        _QUALITY,
        _PLACES,
        "  - use: trajectory  # SLAM error from several start offsets, because single runs vary",
        f"    params: {{start_offsets: {list(_STARTS)}}}",
        "  - use: timing",
        "    params: {frames: 5, repeats: 3}",
    ],
    "quality": [
        _QUALITY,
        "  - features  # keypoint repeatability",
        "  - use: timing",
        "    params: {frames: 5, repeats: 3}",
    ],
    "depth": [
        "  - quality  # bits per pixel",
        "  - depth  # errors in millimeters, and against the sensor's noise",
        "  - use: timing",
        "    params: {frames: 5, repeats: 3}",
    ],
    "speed": [
        _QUALITY,
        "  - use: timing  # on one core, alone on the machine",
        "    params: {frames: 20, repeats: 5}",
    ],
}


def _values(span: list[Any]) -> Any:
    return span[0] if len(span) == 1 else {"grid": span}


def _flow(value: Any) -> str:
    """Format a value on one line of YAML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    plain = isinstance(value, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_.-]*", value)
    return str(value) if plain and value not in ("true", "false", "null", "none", "yes", "no") else json.dumps(value)


def _name(name: str) -> str:
    """Return a matrix name made of the recording's name."""
    return "try-" + (re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "recording")

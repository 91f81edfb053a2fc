"""A matrix that suits a recording: its text, with comments, to run, edit and run again."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, get_args

from codecbench.core.contracts.errors import CodecbenchError, Unsupported
from codecbench.core.engine.planning.estimate import estimate
from codecbench.core.engine.planning.matrix import matrix_from
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.registry import Registry
from codecbench.core.engine.running.warm_up import kernels_to_compile
from codecbench.trial.recording import Recording, counted
from codecbench.trial.wanted_codecs import WantedCodec, read_codec

Aim = Literal["tracking", "quality", "speed"]
AIMS: Final = get_args(Aim)

_STILLS: Final = ("jpeg:5|10|20|40|75", "jpeg2000:ratio=12|30|75", "webp:10|40|75")
_STREAMS: Final = ("h264:crf=22|30|38",)
_STARTS: Final = (0, 1, 2, 3)
"""Four runs are the fewest of which a success rate can be told."""
_TYPICAL_PIXELS: Final = 640 * 480
_FEWEST: Final[dict[str, int]] = {"tracking": 150, "quality": 10, "speed": 10}
"""Frames below which an aim tells nothing: a map takes a few seconds of a recording to begin."""
_COMPILE_S: Final[dict[str, float]] = {"tracking": 60.0, "quality": 30.0, "speed": 5.0}
"""What compiling kernels takes the first time, on two cores."""
_MINUTES: Final[dict[str, float]] = {"tracking": 5.0, "quality": 2.5, "speed": 2.5}
"""How long a user waits who said nothing of it: SLAM from several starts takes its time, pictures need not."""


@dataclass(frozen=True)
class TrialMatrix:
    """The text of a matrix, and what its user is told of how it was chosen.

    estimated_s: wall time; `compiles` where that of compiling kernels is in it, which the cache does not have.
    """

    text: str
    aim: Aim
    frames: int
    settings: int
    estimated_s: float
    compiles: bool
    choices: tuple[str, ...]


def suited_aim(recording: Recording) -> Aim:
    """Tracking where SLAM can run, else the quality of the pictures."""
    return "tracking" if recording.has_camera and recording.frames >= _FEWEST["tracking"] else "quality"


def trial_matrix(
    registry: Registry,
    recording: Recording,
    codecs: Sequence[str] = (),
    aim: Aim | None = None,
    minutes: float | None = None,
) -> TrialMatrix:
    """The matrix of a recording, as many frames of it as can be expected to take the `minutes`.

    codecs: as `read_codec` reads them; by default what is usual and installed. aim: by default what suits the
    recording. minutes: by default 5 for tracking, else 2.5. Raises Unsupported where the aim needs a camera that is
    not known, ParamsError and MatrixError.
    """
    chosen: list[str] = []
    if aim is None:
        aim = suited_aim(recording)
        chosen.append(_why(aim, recording))
    minutes = _MINUTES[aim] if minutes is None else minutes
    if aim == "tracking" and not recording.has_camera:
        raise Unsupported(
            "tracking needs the camera, and this recording has no calibration; give --fov DEGREES (its horizontal "
            "field of view), or a calibration file in a matrix of your own (codecbench init), or --for quality"
        )
    if aim == "tracking" and not recording.has_ground_truth:
        chosen.append(
            "there is no ground truth: the paths that SLAM finds on raw pictures stand in for it, as far as they agree"
        )
    wanted = [read_codec(registry, text) for text in codecs] or _usual(registry, recording)
    if recording.sizes and not codecs:
        names = ", ".join(text.partition(":")[0] for text in _STREAMS)
        chosen.append(f"codecs with memory ({names}) are left out: they need pictures of one size")
    draft = _Draft(recording, tuple(wanted), aim, recording.frames)
    seconds = draft.seconds(registry)
    budget_s = max(60.0 * minutes - _COMPILE_S[aim], 0.0)
    if seconds > budget_s:
        fewest = min(_FEWEST[aim], recording.frames)
        few_s = replace(draft, frames=fewest).seconds(registry)
        share = 0.0 if seconds <= few_s else min(1.0, max(0.0, (budget_s - few_s) / (seconds - few_s)))
        draft = replace(draft, frames=fewest + int(share * (recording.frames - fewest)))
        seconds = draft.seconds(registry)
        about = f"about {minutes:g} minute{'' if minutes == 1 else 's'} (--minutes)"
        if draft.frames < recording.frames:
            chosen.append(
                f"the first {draft.frames:,} of {counted(recording.frames, 'frame')}, to be done in {about}; "
                f"the other frames are not looked at"
            )
        else:
            chosen.append(f"all {counted(draft.frames, 'frame')} are needed, which may take more than {about}")
    settings = 1 + sum(len(codec) for codec in wanted)
    compiles = len(kernels_to_compile(draft.plan(registry).cells, registry)) > 0
    estimated_s = seconds + (_COMPILE_S[aim] if compiles else 0.0)
    return TrialMatrix(draft.text(), aim, draft.frames, settings, estimated_s, compiles, tuple(chosen))


def _why(aim: Aim, recording: Recording) -> str:
    """Why this is what codecs are judged by, and how it would be tracking where that is a parameter away."""
    if aim == "tracking":
        return "the camera is known, so codecs are judged by what SLAM makes of their pictures (--for tracking)"
    so = "so codecs are judged by pictures and features (--for quality)"
    if recording.has_camera:
        verb = "is" if recording.frames == 1 else "are"
        return f"{counted(recording.frames, 'frame')} {verb} too few for SLAM, {so}"
    enough = recording.frames >= _FEWEST["tracking"] and not recording.sizes and "fov_deg" in recording.settable
    how = "; with --fov DEGREES, the horizontal field of view, SLAM can run" if enough else ""
    return f"the camera is not known, {so}{how}"


def _usual(registry: Registry, recording: Recording) -> list[WantedCodec]:
    """Codecs that anybody would ask for, those of them that are installed and take the recording's pictures."""
    return [
        read_codec(registry, text)
        for text in (*_STILLS, *(() if recording.sizes else _STREAMS))
        if registry.find("codec", text.partition(":")[0]).missing is None
    ]


@dataclass(frozen=True)
class _Draft:
    """A matrix of so many frames."""

    recording: Recording
    codecs: tuple[WantedCodec, ...]
    aim: Aim
    frames: int

    def seconds(self, registry: Registry) -> float:
        """How long it can be expected to take. Typical costs are of frames of 640x480."""
        plan = self.plan(registry)
        cells = [cell for cell in plan.cells if cell.unsupported is None]
        if not cells:
            reasons = "; ".join(dict.fromkeys(str(cell.unsupported) for cell in plan.cells))
            raise CodecbenchError(f"nothing of this can be run here: {reasons}")
        pixels = self.recording.width * self.recording.height
        return estimate(plan, cells, len(plan.jobs), {}).seconds * max(pixels / _TYPICAL_PIXELS, 0.2)

    def plan(self, registry: Registry) -> Plan:
        """The plan of the matrix."""
        return make_plan(matrix_from(self.text(), registry), registry)

    def text(self) -> str:
        """The YAML text."""
        recording = self.recording
        params = {**recording.params, **({"stop": self.frames} if self.frames < recording.frames else {})}
        lines = [
            "# What codecbench chose for this recording. Edit it and run it again: codecbench run FILE --out RUN",
            f"# {recording}",
            "version: 1",
            f"name: {_name(recording.name)}",
            "sequences:",
            f"  - use: {recording.dataset}",
            f"    params: {_flow(params)}",
            "codecs:",
            "  - raw  # the pictures as they are: every task is judged beside them",
        ]
        for codec in self.codecs:
            lines.append(f"  - use: {codec.name}")
            if codec.values:
                lines.append(f"    params: {_flow({key: _values(span) for key, span in codec.values.items()})}")
        lines += ["evaluators:", *_EVALUATORS[self.aim]]
        return "\n".join(lines) + "\n"


_QUALITY: Final = "  - quality  # bits a pixel, PSNR, SSIM"
_FEATURES: Final = "  - features  # what a tracker's keypoints lose"
_EVALUATORS: Final[dict[str, list[str]]] = {
    "tracking": [
        _QUALITY,
        "  - use: trajectory  # what SLAM makes of the camera's path, from several starts: single runs scatter",
        f"    params: {{start_offsets: {list(_STARTS)}}}",
        "  - use: timing",
        "    params: {frames: 5, repeats: 3}",
    ],
    "quality": [_QUALITY, _FEATURES, "  - use: timing", "    params: {frames: 5, repeats: 3}"],
    "speed": [
        _QUALITY,
        "  - use: timing  # on one core, alone on the machine",
        "    params: {frames: 20, repeats: 5}",
    ],
}


def _values(span: list[Any]) -> Any:
    return span[0] if len(span) == 1 else {"grid": span}


def _flow(value: Any) -> str:
    """A value on one line of YAML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    plain = isinstance(value, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_.-]*", value)
    return str(value) if plain and value not in ("true", "false", "null", "none", "yes", "no") else json.dumps(value)


def _name(name: str) -> str:
    """The recording's name as a matrix may be called."""
    return "try-" + (re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "recording")

"""`codecbench.trial`, the Python form of `codecbench try`: open a recording, fit a matrix, run it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from codecbench.core.contracts.errors import DatasetError, ParamsError
from codecbench.core.engine.planning.matrix import matrix_from
from codecbench.core.engine.plugins.registry import Registry, installed
from codecbench.core.engine.text import counted
from codecbench.core.facade import Run, open_run
from codecbench.core.rounds.running import run_matrix
from codecbench.trial.recording import (
    MOST_LISTED,
    Recording,
    describe_left_out,
    fov_from_exif,
    params_without,
    recognize,
    unreadable_frames,
)
from codecbench.trial.trial_matrix import Purpose, TrialMatrix, trial_matrix


def open_recording(
    path: str | Path,
    fov_deg: float | None = None,
    params: dict[str, Any] | None = None,
    registry: Registry | None = None,
) -> Recording:
    """Open the recording at `path`.

    fov_deg: the horizontal field of view of a camera that the recording does not describe; by default that from the
    EXIF data of its images. params: more parameters of its dataset. Raises DatasetError if no dataset recognizes it, or
    if a camera is given for images of several sizes.
    """
    registry, path = registry or installed(), Path(path)
    given = {**(params or {}), **({} if fov_deg is None else {"fov_deg": fov_deg})}
    recording = recognize(registry, path, given)
    if recording.sizes and recording.has_camera:
        raise DatasetError(f"{path}: its frames differ in size, and a camera has one size; omit the camera")
    added: dict[str, Any] = {}
    assumed: list[str] = []
    for name, value in recording.suited.items():
        if name not in given and name in recording.settable:
            added[name] = value
            assumed.append(f"{name}={json.dumps(value)} is set to suit the recording (--set {name}=... for another)")
    if (exif_fov_deg := _exif_fov_deg(recording, path)) is not None:
        added["fov_deg"] = exif_fov_deg
        assumed.append(f"the camera's field of view is {exif_fov_deg:g} degrees, from the focal length in EXIF")
    if not added:
        return recording
    reopened = recognize(registry, path, {**given, **added})
    return replace(reopened, assumed=(*reopened.assumed, *assumed))


def fit_matrix(
    registry: Registry,
    recording: Recording,
    codecs: Sequence[str] = (),
    aim: Purpose | None = None,
    minutes: float | None = None,
) -> TrialMatrix:
    """Return the `trial_matrix` of a recording without its unreadable frames, which the choices list.

    Reads only frames that the matrix uses. Raises DatasetError if more than half of them are unreadable.
    """
    left_out: list[str] = []
    while True:
        matrix = trial_matrix(registry, recording, codecs, aim, minutes)
        faults = []
        if "skip" in recording.settable:
            name, read = recording.dataset, (recording.params, matrix.frames)
            faults = registry.ask(unreadable_frames, name, *read, of=[("dataset", name)], times=10)
        if 2 * len(faults) > matrix.frames:
            more = f"and {len(faults) - 1} more of {matrix.frames} frames, more than half"
            raise DatasetError(f"{faults[0][0]} ({more})")
        if not faults:
            break
        params = recording.params
        for error in faults:
            left_out.append(describe_left_out(DatasetError(*error)))
            params = params_without(params, error[1])
        recording = replace(recording, params=params, frames=recording.frames - len(faults))
    if (rest := len(left_out) - MOST_LISTED) > 0:
        left_out[MOST_LISTED:] = [f"{counted(rest, 'more frame')} left out for similar reasons (`skip`)"]
    return replace(matrix, choices=(*left_out, *matrix.choices))


def _exif_fov_deg(recording: Recording, path: Path) -> float | None:
    """Return the field of view from EXIF; None if the camera is known, or images differ in size, or EXIF has none."""
    if recording.has_camera or recording.sizes or "fov_deg" not in recording.settable:
        return None
    return fov_from_exif(path)


def trial(
    path: str | Path,
    *,
    codecs: Sequence[str] = (),
    aim: Purpose | None = None,
    minutes: float | None = None,
    fov_deg: float | None = None,
    params: dict[str, Any] | None = None,
    out: str | Path | None = None,
    workers: int | None = None,
) -> Run:
    """Try codecs on the recording at `path` and return the results.

    codecs: such as `jpeg:5..90`; aim: `tracking`, `quality` or `speed`; minutes: about how long it may take, by default
    5 for tracking and else 2.5; the rest as in `open_recording` and `codecbench.run`. Raises DatasetError, ParamsError,
    MatrixError and Unsupported.
    """
    registry = installed()
    fitted = fit_matrix(registry, open_recording(path, fov_deg, params, registry), codecs, aim, minutes)
    matrix = matrix_from(fitted.text, registry)
    return open_run(run_matrix(matrix, out, workers=workers, minutes=fitted.most_minutes).folder)


def parse_params(texts: Sequence[str]) -> dict[str, Any]:
    """Parse parameters of a dataset, as `--set NAME=VALUE` gives them. Raises ParamsError for another spelling."""
    params: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name or name in params:
            raise ParamsError(f"--set {text}: write NAME=VALUE, each name once, such as topic=/camera/image_raw")
        try:
            params[name] = json.loads(value)
        except ValueError:
            params[name] = value
    return params

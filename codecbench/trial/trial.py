"""A recording, looked at, given a matrix and run: what `codecbench try` does, for Python."""

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
from codecbench.trial.focal_length import fov_deg_of
from codecbench.trial.recording import MOST_SAID, Recording, less, recognised, said_of, unreadable
from codecbench.trial.trial_matrix import Purpose, TrialMatrix, trial_matrix


def looked_at(
    path: str | Path,
    fov_deg: float | None = None,
    params: dict[str, Any] | None = None,
    registry: Registry | None = None,
) -> Recording:
    """The recording at `path`, opened.

    fov_deg: the horizontal field of view of a camera that the recording does not describe; by default what its pictures
    say in EXIF. params: more parameters of its dataset. Raises DatasetError where nothing is recognised and where
    a camera is given to pictures of several sizes.
    """
    registry, path = registry or installed(), Path(path)
    given = {**(params or {}), **({} if fov_deg is None else {"fov_deg": fov_deg})}
    recording = recognised(registry, path, given)
    if recording.sizes and recording.has_camera:
        raise DatasetError(f"{path}: its pictures differ in size, and a camera has one; leave out what gives it")
    taken: dict[str, Any] = {}
    assumed: list[str] = []
    for name, value in recording.suited.items():
        if name not in given and name in recording.settable:
            taken[name] = value
            assumed.append(f"{name}={json.dumps(value)} suits what was found and is set (--set {name}=... for another)")
    if (noted := _noted_view(recording, path)) is not None:
        taken["fov_deg"] = noted
        view = f"its pictures note a focal length that sees {noted:g} degrees (EXIF)"
        assumed.append(f"{view}, which is taken for the camera")
    if not taken:
        return recording
    again = recognised(registry, path, {**given, **taken})
    return replace(again, assumed=(*again.assumed, *assumed))


def fitted(
    registry: Registry,
    recording: Recording,
    codecs: Sequence[str] = (),
    aim: Purpose | None = None,
    minutes: float | None = None,
) -> TrialMatrix:
    """The matrix that suits a recording, as `trial_matrix`, without frames that cannot be read, which its choices say.

    Only frames that the matrix uses are read. Raises DatasetError where more than half of them cannot be.
    """
    left_out: list[str] = []
    while True:
        made = trial_matrix(registry, recording, codecs, aim, minutes)
        found = []
        if "skip" in recording.settable:
            name, read = recording.dataset, (recording.params, made.frames)
            found = registry.ask(unreadable, name, *read, of=[("dataset", name)], times=10)
        if 2 * len(found) > made.frames:
            more = f"and {len(found) - 1} more of {made.frames} frames, more than half"
            raise DatasetError(f"{found[0][0]} ({more})")
        if not found:
            break
        params = recording.params
        for error in found:
            left_out.append(said_of(DatasetError(*error)))
            params = less(params, error[1])
        recording = replace(recording, params=params, frames=recording.frames - len(found))
    if (rest := len(left_out) - MOST_SAID) > 0:
        left_out[MOST_SAID:] = [f"{counted(rest, 'more frame')} left out for such reasons (`skip`)"]
    return replace(made, choices=(*left_out, *made.choices))


def _noted_view(recording: Recording, path: Path) -> float | None:
    """The field of view that EXIF tells of a camera which is not known and whose pictures have one size."""
    if recording.has_camera or recording.sizes or "fov_deg" not in recording.settable:
        return None
    return fov_deg_of(path)


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
    5 for tracking and else 2.5; the rest as of `looked_at` and `codecbench.run`. Raises DatasetError, ParamsError,
    MatrixError and Unsupported.
    """
    registry = installed()
    made = fitted(registry, looked_at(path, fov_deg, params, registry), codecs, aim, minutes)
    matrix = matrix_from(made.text, registry)
    return open_run(run_matrix(matrix, out, workers=workers, minutes=made.most_minutes).folder)


def added_params(texts: Sequence[str]) -> dict[str, Any]:
    """Parameters of a dataset as `--set NAME=VALUE` gives them. Raises ParamsError for another spelling."""
    found: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name or name in found:
            raise ParamsError(f"--set {text}: write NAME=VALUE, each name once, such as topic=/camera/image_raw")
        try:
            found[name] = json.loads(value)
        except ValueError:
            found[name] = value
    return found

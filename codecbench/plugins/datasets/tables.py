"""Tables of numbers in text files: rows with line numbers for errors, times and poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Trajectory

Floats = NDArray[np.float64]
_LEAST_NORM = 0.9
_MOST_NORM = 1.1


@dataclass(frozen=True)
class Row:
    """The fields of one line of a text file."""

    file: Path
    line: int
    fields: tuple[str, ...]

    @property
    def where(self) -> str:
        return f"{self.file}:{self.line}"

    def number(self, column: int) -> float:
        """A field as a finite number. Raises DatasetError if it is none."""
        text = self.fields[column]
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise DatasetError(f"{self.where}: field {column + 1} is {text!r}, which is not a finite number")
        return value

    def numbers(self, first: int = 0) -> list[float]:
        """The fields from index `first` on as finite numbers. Raises DatasetError."""
        return [self.number(column) for column in range(first, len(self.fields))]

    def seconds_from_ns(self, column: int) -> float:
        """Convert a field in nanoseconds to seconds. Raises DatasetError."""
        text = self.fields[column]
        if not text.isascii() or not text.isdigit():
            raise DatasetError(f"{self.where}: field {column + 1} is {text!r}, which is not a whole number of ns")
        return int(text) / 1e9


def read_text(file: Path, what: str, remedy: str = "") -> str:
    """Read a text file. Raises DatasetError; the message names `what` is missing and the `remedy`."""
    try:
        return file.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise DatasetError(f"{file}: {what} is missing" + (f"; {remedy}" if remedy else "")) from error
    except OSError as error:
        raise DatasetError(f"{file}: {what} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DatasetError(f"{file}: {what} is not text, at byte {error.start}") from error


def read_rows(
    file: Path, what: str, columns: int, separator: str | None = None, remedy: str = "", exact: bool = False
) -> list[Row]:
    """Read the rows of a table, skipping empty lines and lines that begin with #.

    A row has at least `columns` fields, or exactly that many if `exact`. Raises DatasetError if a row has another
    length, or if there are no rows.
    """
    rows = list(_rows(file, read_text(file, what, remedy), separator))
    for row in rows:
        if len(row.fields) < columns or (exact and len(row.fields) > columns):
            raise DatasetError(f"{row.where}: {len(row.fields)} field(s), {what} has {columns}")
    if not rows:
        raise DatasetError(f"{file}: {what} has no rows")
    return rows


def _rows(file: Path, text: str, separator: str | None) -> Iterator[Row]:
    for line, content in enumerate(text.splitlines(), start=1):
        content = content.strip()
        if content and not content.startswith("#"):
            yield Row(file, line, tuple(field.strip() for field in content.split(separator)))


def increasing_times(times_s: Sequence[float], rows: Sequence[Row]) -> Floats:
    """The times as an array. Raises DatasetError, naming the row, if a time is not after the one before."""
    for before, now, row in zip(times_s, times_s[1:], rows[1:], strict=False):
        if now <= before:
            kind = "repeats" if now == before else "is before"
            raise DatasetError(f"{row.where}: time {row.fields[0]} {kind} that of the row before; sort the file")
    return np.array(times_s, dtype=np.float64)


def rate_hz(times_s: Floats, otherwise: float) -> float:
    """The nominal frame rate: one over the median interval, or `otherwise` for a single frame."""
    return float(1.0 / np.median(np.diff(times_s))) if len(times_s) > 1 else otherwise


def trajectory_from_quaternions(times_s: Floats, poses: Floats, order: str, rows: Sequence[Row]) -> Trajectory:
    """Convert rows (N, 7) of a position and a unit quaternion to a trajectory.

    order: `xyzw` or `wxyz`. Quaternions are normalized. Raises DatasetError if one is far from unit length.
    """
    quaternions = poses[:, 3:7] if order == "xyzw" else np.roll(poses[:, 3:7], -1, axis=1)
    ordered = np.column_stack([poses[:, :3], quaternions])
    return Trajectory(times_s, transforms_from_quaternions(ordered, lambda number: rows[number].where))


def transforms_from_quaternions(poses: Floats, where: Callable[[int], str]) -> Floats:
    """Rigid transforms (N, 4, 4) from rows (N, 7) of a position and a unit quaternion x, y, z, w.

    Quaternions are normalized. Raises DatasetError, with `where` of the row, if one is far from unit length or a
    number is not finite.
    """
    norms = np.linalg.norm(poses[:, 3:], axis=1)
    wrong = np.flatnonzero(~((norms >= _LEAST_NORM) & (norms <= _MOST_NORM)))
    if len(wrong):
        raise DatasetError(f"{where(wrong[0])}: quaternion has length {norms[wrong[0]]:.4g}, not 1")
    wrong = np.flatnonzero(~np.isfinite(poses[:, :3]).all(axis=1))
    if len(wrong):
        raise DatasetError(f"{where(wrong[0])}: position contains a number that is not finite")
    transforms = np.tile(np.eye(4), (len(poses), 1, 1))
    transforms[:, :3, :3] = _rotations(poses[:, 3:] / norms[:, None])
    transforms[:, :3, 3] = poses[:, :3]
    return transforms


def _rotations(quaternions: Floats) -> Floats:
    """(N, 3, 3) rotation matrices of unit quaternions (N, 4) in the order x, y, z, w."""
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def orthonormalize(transform: Floats, where: str) -> Floats:
    """Replace the rotation of a transform (4, 4) by the nearest exact one (polar decomposition).

    Files give only a few decimals. Raises DatasetError if the matrix is not close to a rotation.
    """
    left, sizes, right = np.linalg.svd(transform[:3, :3])
    if np.abs(sizes - 1.0).max() > 1e-2 or np.linalg.det(transform[:3, :3]) < 0:
        raise DatasetError(f"{where}: the first three columns are not a rotation")
    nearest = transform.copy()
    nearest[:3, :3] = left @ right
    return nearest

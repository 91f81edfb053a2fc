"""What a task can change of its process besides memory, and how the next task finds it as it was."""

from __future__ import annotations

import ctypes
import gc
import locale
import os
import resource
import signal
import sys
import warnings
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

_LIMITS: Final = tuple(
    number for name, number in sorted(vars(resource).items()) if name.startswith("RLIMIT_") and number != -1
)
_SMALLEST_NORMAL: Final = 2.2250738585072014e-308


@dataclass(frozen=True)
class ProcessState:
    """Limits, signal handlers, environment, folder, umask, locale, warning filters, the interpreter's settings, where
    standard input and output go, and floating-point mode."""

    limits: dict[int, tuple[int, int]]
    handlers: dict[int, Any] = field(repr=False)
    environment: dict[str, str] = field(repr=False)
    folder: Path
    umask: int
    locale: str
    filters: tuple[Any, ...] = field(repr=False)
    interpreter: tuple[Any, ...] = field(repr=False)
    streams: tuple[Any, ...]
    float_mode: tuple[Any, ...]

    @classmethod
    def now(cls) -> ProcessState:
        """The state of this process, from its main thread."""
        return cls(
            limits={limit: resource.getrlimit(limit) for limit in _LIMITS},
            handlers={number: signal.getsignal(number) for number in signal.valid_signals()},
            environment=dict(os.environ),
            folder=_folder(),
            umask=_umask(),
            locale=locale.setlocale(locale.LC_ALL),
            filters=tuple(warnings.filters),
            interpreter=(sys.getrecursionlimit(), sys.gettrace(), sys.getprofile(), gc.isenabled(), np.geterr()),
            streams=tuple(map(_stream, range(3))),
            float_mode=_float_mode(),
        )

    def restore(self) -> bool:
        """Make this process as it was; False where that cannot be done, so that the process had better end."""
        _restore_interpreter(*self.interpreter)
        changed = ProcessState.now()
        with suppress(OSError, ValueError, TypeError, locale.Error):
            for limit, pair in self.limits.items():
                if changed.limits[limit] != pair:
                    resource.setrlimit(limit, pair)
            for number, handler in self.handlers.items():
                if changed.handlers[number] is not handler:
                    signal.signal(number, handler)
            if changed.environment != self.environment:
                os.environ.clear()
                os.environ.update(self.environment)
            if changed.folder != self.folder or not self.folder.is_dir():
                self.folder.mkdir(parents=True, exist_ok=True)
                os.chdir(self.folder)
            os.umask(self.umask)
            locale.setlocale(locale.LC_ALL, self.locale)
            warnings.filters[:] = self.filters  # type: ignore[index]
            return ProcessState.now() == self
        return False


def _restore_interpreter(depth: int, trace: Any, profile: Any, collects: bool, numpy_errors: Any) -> None:
    """Settings of Python and NumPy; timers, of which there are none, cannot send their signal to a later task."""
    sys.settrace(trace)
    sys.setprofile(profile)
    sys.setrecursionlimit(depth)
    (gc.enable if collects else gc.disable)()
    np.seterr(**numpy_errors)
    for timer in (signal.ITIMER_REAL, signal.ITIMER_VIRTUAL, signal.ITIMER_PROF):
        signal.setitimer(timer, 0.0)


def _stream(descriptor: int) -> tuple[int, int] | None:
    """Which file is behind a descriptor; None where it is closed. A descriptor freed is the next file's."""
    with suppress(OSError):
        status = os.fstat(descriptor)
        return status.st_dev, status.st_ino
    return None


def _folder() -> Path:
    """The working folder; an empty path where it was removed."""
    with suppress(OSError):
        return Path.cwd()
    return Path()


def _umask() -> int:
    umask = os.umask(0o077)
    os.umask(umask)
    return umask


def _float_mode() -> tuple[Any, ...]:
    """Rounding of the C library and of Python, and whether numbers below the smallest normal one are kept."""
    sums = tuple(1.0 + sign * step for sign in (1.0, -1.0) for step in (2.0**-53, 3 * 2.0**-54))
    library = ctypes.CDLL(None)
    rounding = library.fegetround() if hasattr(library, "fegetround") else 0
    return rounding, sums, _SMALLEST_NORMAL / float(len(sums)) != 0.0

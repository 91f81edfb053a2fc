"""The log file of a run: one line for each thing worth knowing, appended run after run."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, Self


@contextmanager
def log_to(path: Path, level: int) -> Iterator[None]:
    """Write what codecbench logs to `path` meanwhile."""
    logger = logging.getLogger("codecbench")
    handler = _LogFile(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    handler.setLevel(level)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.setLevel(before)
        logger.removeHandler(handler)
        with suppress(OSError):
            handler.close()


class _LogFile(logging.FileHandler):
    """A log whose lines are dropped where they cannot be written: a full disk is told by what cannot be recorded."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - named by logging
        pass


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interruption:
    """A context in which signals set `requested` instead of ending the process. Inert outside the main thread.

    SIGHUP stays ignored where it is, as under nohup.
    """

    def __init__(self) -> None:
        self.signal_name: str | None = None
        self._before: dict[signal.Signals, Any] = {}

    @property
    def requested(self) -> bool:
        return self.signal_name is not None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            deaf = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            heeded = _SIGNALS[:-1] if deaf else _SIGNALS
            self._before = {number: signal.signal(number, self._request) for number in heeded}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _request(self, number: int, frame: FrameType | None) -> None:
        if self.requested and number == signal.SIGINT:
            raise KeyboardInterrupt
        self.signal_name = signal.Signals(number).name

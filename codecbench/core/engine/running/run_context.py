"""What surrounds a run: its log file, and signals that end it early."""

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
    """Append codecbench's log messages to `path` in the block."""
    logger = logging.getLogger("codecbench")
    handler = _LogFile(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    handler.setLevel(level)
    old_level = logger.level
    logger.addHandler(handler)
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.setLevel(old_level)
        logger.removeHandler(handler)
        with suppress(OSError):
            handler.close()


class _LogFile(logging.FileHandler):
    """A log that drops lines that cannot be written: failing records already reveal a full disk."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - name given by logging
        pass


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interruption:
    """A context in which the first SIGINT, SIGTERM or SIGHUP sets `requested` instead of ending the process.

    A second SIGINT raises KeyboardInterrupt. Inert outside the main thread. SIGHUP stays ignored if it is, as under
    nohup.
    """

    def __init__(self) -> None:
        self.signal_name: str | None = None
        self._old_handlers: dict[signal.Signals, Any] = {}

    @property
    def requested(self) -> bool:
        return self.signal_name is not None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            ignores_hangup = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            signals = _SIGNALS[:-1] if ignores_hangup else _SIGNALS
            self._old_handlers = {number: signal.signal(number, self._request) for number in signals}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._old_handlers.items():
            signal.signal(number, handler)

    def _request(self, number: int, frame: FrameType | None) -> None:
        if self.requested and number == signal.SIGINT:
            raise KeyboardInterrupt
        self.signal_name = signal.Signals(number).name

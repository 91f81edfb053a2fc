"""Ending a run early: the first SIGINT, SIGTERM or SIGHUP asks for it, a second SIGINT does not wait."""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Any, Self

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

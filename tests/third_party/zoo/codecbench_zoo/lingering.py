"""Codecs that leave their process other than they found it."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from codecbench import NULL_TRACE, Image, Trace
from codecbench_zoo.tame import TameCodec


class _Lingering(TameCodec):
    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> Any:
        self.leave()
        return super().encode(image)

    def leave(self) -> None:
        raise NotImplementedError


class Cleans(_Lingering):
    """Removes what it takes for its own temporary files."""

    def leave(self) -> None:
        for path in Path().iterdir():
            shutil.rmtree(path, ignore_errors=True)
            path.unlink(missing_ok=True)


class Scribbles(_Lingering):
    """Writes into the frame that it was given."""

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> Any:
        bitstream = TameCodec.encode(self, image)
        image[:] = 0
        return bitstream


class LowersTheStack(_Lingering):
    def leave(self) -> None:
        sys.setrecursionlimit(400)


class SetsTimers(_Lingering):
    """Has a signal sent when somebody else is at work."""

    def leave(self) -> None:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, 0.4)


class CatchesSignals(_Lingering):
    def leave(self) -> None:
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGALRM):
            signal.signal(number, lambda *_: os._exit(0))


class LowersLimits(_Lingering):
    """Allows this process no more files, for good."""

    def leave(self) -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (8, 8))


class ClosesOutput(_Lingering):
    """Frees the descriptors on which workers print, for files that come after."""

    def leave(self) -> None:
        os.closerange(0, 3)


class LeavesThreads(_Lingering):
    def leave(self) -> None:
        for _ in range(3):
            threading.Thread(target=time.sleep, args=(3600,), daemon=True).start()


class LeavesChildren(_Lingering):
    """Leaves processes that have left its group."""

    def leave(self) -> None:
        if os.fork() == 0:
            os.setsid()
            if os.fork() == 0:
                time.sleep(3600)
            os._exit(0)


class LeavesItsGroup(_Lingering):
    def leave(self) -> None:
        os.setpgid(0, 0)


class LeavesAHook(_Lingering):
    """Hangs whoever wants to end its process."""

    def leave(self) -> None:
        import atexit

        atexit.register(time.sleep, 3600)


class Innocent(TameCodec):
    """Does what a codec does."""

"""Codecs that leave their process other than they found it. After each comes an innocent that must not notice."""

from __future__ import annotations

import ctypes
import gc
import locale
import os
import random
import resource
import shutil
import signal
import sys
import threading
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from codecbench import NULL_TRACE, Image, Trace
from codecbench_zoo.tame import TameCodec


class _Lingering(TameCodec):
    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> Any:
        self.leave()
        return super().encode(image)

    def leave(self) -> None:
        raise NotImplementedError


class Rounds(_Lingering):
    """Leaves the processor rounding upwards, and the folder, umask and environment as it likes them."""

    def leave(self) -> None:
        ctypes.CDLL(None).fesetround(0x800)
        os.chdir("/")
        os.umask(0)
        os.environ["OMP_NUM_THREADS"] = "64"


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


class RaisesNumpysErrors(_Lingering):
    def leave(self) -> None:
        np.seterr(all="raise")


class WarnsOfEverything(_Lingering):
    def leave(self) -> None:
        warnings.simplefilter("error")


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


class SpeaksTurkish(_Lingering):
    def leave(self) -> None:
        for name in ("tr_TR.UTF-8", "C"):
            try:
                locale.setlocale(locale.LC_ALL, name)
            except locale.Error:
                continue


class Seeds(_Lingering):
    def leave(self) -> None:
        random.seed(0)
        np.random.seed(0)  # noqa: NPY002 - that is what it does
        gc.disable()


class Traces(_Lingering):
    """Watches every call in its process."""

    def leave(self) -> None:
        sys.setprofile(lambda *_: None)


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


class LeavesAHook(_Lingering):
    """Hangs whoever wants to end its process."""

    def leave(self) -> None:
        import atexit

        atexit.register(time.sleep, 3600)


class Innocent(TameCodec):
    """Does what a codec does."""

"""The work of a host process: it calls functions of codecbench on the plugins of its distribution, and returns data.

It imports as little as possible, because `codecbench list` waits for it.
"""

from __future__ import annotations

import ctypes
import faulthandler
import functools
import gc
import importlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
from dataclasses import asdict
from typing import Any, Final

from codecbench.core.contracts.hooks import KINDS
from codecbench.core.engine.hosting.channel import CRASH_FILE, Channel, Exposed, SharedMemory
from codecbench.core.engine.plugins.entry_points import points_of
from codecbench.core.engine.plugins.fingerprint import code_of
from codecbench.core.engine.plugins.plugin import OURS
from codecbench.core.engine.plugins.registry import Registry

_PR_SET_PDEATHSIG: Final = 1
_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3
_MALLOC_BYTES: Final = 32 << 20
"""Largest block of memory that glibc keeps for itself instead of returning it to the system."""
_state: dict[str, str] = {}


def serve(descriptors: list[int], distribution: str, folder: str) -> None:
    """Serve calls until the caller is gone, then remove `folder`, where this process keeps its temporary files.

    descriptors: of pipes, to read and to write, and of memory, to write and to read.
    """
    _state["distribution"] = distribution
    keep_memory()
    tempfile.tempdir = folder  # even if a plugin removes it; otherwise the system's would be used
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    crash = os.open(os.path.join(folder, CRASH_FILE), os.O_WRONLY | os.O_CREAT, 0o600)
    faulthandler.enable(crash, all_threads=False)
    reads, writes, sends, receives = descriptors
    channel = Channel(reads, writes, SharedMemory(sends), SharedMemory(receives), lambda *_: None, obeys=True)
    channel.serve_forever()
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


@functools.cache
def registry() -> Registry:
    """Return the plugins of this host's distribution and codecbench's own."""
    return Registry([*points_of(OURS), *points_of(_state["distribution"])])


def call_function(module_function: str, *arguments: Any) -> Any:
    """Call a function of codecbench, `module:name`, with this host's registry and arguments; return JSON types."""
    module, _, name = module_function.partition(":")
    return json.loads(json.dumps(getattr(importlib.import_module(module), name)(registry(), *arguments)))


def offers() -> dict[str, Any]:
    """Return what the distribution offers, as JSON types."""
    hosted_registry = Registry(points_of(_state["distribution"]))
    plugins = [
        {"kind": kind, "spec": asdict(plugin.spec), "entry_point": hosted_registry.entry_point(plugin)}
        for kind in KINDS
        for plugin in hosted_registry.plugins(kind)
    ]
    return {"plugins": plugins, "problems": [asdict(problem) for problem in hosted_registry.problems]}


def create_plugin(kind: Any, name: str, params: dict[str, Any], seed: int) -> Exposed:
    """Create a plugin with these parameters; for a dataset, open its sequence. seed: of global generators before that.

    Its version and its code's fingerprint are sent with it.
    """
    seed_generators(seed)
    code = code_of(registry().find(kind, name))
    instance = registry().create(kind, name, params)
    version = instance.version
    gc.freeze()  # keeps garbage collection out of time measurements
    if kind == "dataset":
        return Exposed("sequence", instance.open(), code=code, of_version=version)
    return Exposed(kind, instance, code=code, of_version=version)


def keep_memory() -> None:
    """Make freed memory be reused: getting new pages for each picture can take as long as decoding it."""
    for setting in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD) if sys.platform == "linux" else ():
        ctypes.CDLL(None).mallopt(setting, _MALLOC_BYTES)


def seed_generators(seed: int) -> None:
    """Seed the global generators, so that foreign code that uses them gives the same results in every order."""
    import cv2  # slow, and hosts that only list plugins do not need them
    import numpy as np

    seed %= 1 << 32
    cv2.setNumThreads(1)
    cv2.setRNGSeed(seed >> 1)
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - for foreign code that uses the global generator

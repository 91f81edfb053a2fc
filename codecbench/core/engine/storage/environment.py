"""Describe what a result was computed on: machine, system, Python, libraries, plugins, and state of the checkout.

The description is made in a worker, which has loaded the libraries. `environment_id` hashes what can change a result or
a time; what changes by itself (`volatile`) is stored but not hashed. A run folder has one file per environment.
"""

from __future__ import annotations

import functools
import json
import logging
import os
import platform
import re
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

from codecbench.core.engine.identity import digest, json_from_bytes
from codecbench.core.engine.plugins.entry_points import origins
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.storage.plain_file import read_plain
from codecbench.core.engine.text import clean_line, clean_value

_DISTRIBUTIONS: Final = (
    "codecbench", "numpy", "scipy", "numba", "llvmlite", "opencv-python-headless", "opencv-python", "glymur",
    "pillow", "scikit-image", "imagecodecs", "evo", "pandas", "pyarrow", "pydantic", "pebble", "distributed",
    "pyorbslam3",
)  # fmt: skip
_THREAD_VARIABLES: Final = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
)  # fmt: skip
_CPU: Final = Path("/sys/devices/system/cpu")


def environment_id(environment: dict[str, Any]) -> str:
    """Return a digest of everything in the description that is not volatile."""
    return digest({name: value for name, value in environment.items() if name != "volatile"})[:16]


def describe_environment() -> dict[str, Any]:
    """Describe the environment of this process as JSON types; what cannot be read is None."""
    return {
        "machine": describe_machine(),
        "system": {"name": platform.system(), "release": platform.release(), "libc": " ".join(platform.libc_ver())},
        "python": {"version": platform.python_version(), "implementation": platform.python_implementation()},
        "distributions": _versions(),
        "libraries": _bundled_libraries(),
        "plugins": origins(),
        "threads": {name: os.environ.get(name) for name in _THREAD_VARIABLES},
        "checkout": _checkout(),
        "volatile": {"host": platform.node(), "governor": _text(_CPU / "cpu0/cpufreq/scaling_governor")},
    }


def describe_machine() -> dict[str, Any]:
    """Describe processor, cores and memory as JSON types; what cannot be read is None."""
    cpu = _text(Path("/proc/cpuinfo")) or ""
    flags = re.search(r"^flags\s*:(.*)$", cpu, re.MULTILINE)
    model = re.search(r"^model name\s*:\s*(.*)$", cpu, re.MULTILINE)
    memory = re.search(r"^MemTotal:\s*(\d+) kB", _text(Path("/proc/meminfo")) or "", re.MULTILINE)
    cpu_flags = flags.group(1).split() if flags else []
    return {
        "architecture": platform.machine(),
        "cpu": model.group(1) if model else platform.processor() or None,
        "cores": os.cpu_count(),
        "simd": [name for name in ("sse4_2", "avx", "avx2", "avx512f", "neon") if name in cpu_flags],
        "memory_mb": int(memory.group(1)) // 1024 if memory else None,
    }


def _versions() -> dict[str, str]:
    versions = {}
    for name in _DISTRIBUTIONS:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions


def _bundled_libraries() -> dict[str, str]:
    """Return the versions of image libraries inside OpenCV, from its build information."""
    import cv2  # only workers need it

    libraries = {}
    for line in cv2.getBuildInformation().splitlines():
        match = re.match(r"\s+(JPEG|PNG|JPEG 2000|ZLib):\s+(.*)", line)
        if match:
            libraries[f"opencv {match.group(1)}"] = match.group(2).strip()
    return libraries


@functools.cache
def _checkout() -> dict[str, Any] | None:
    """Return the commit of codecbench's source tree and whether it has changes; None outside a checkout."""
    folder = Path(__file__).resolve().parents[4]
    if not (folder / ".git").exists():
        return None
    commit = _git(folder, "rev-parse", "HEAD")
    changes = _git(folder, "status", "--porcelain", "--untracked-files=no", "--", "codecbench")
    return {"commit": commit, "changed": None if changes is None else bool(changes)}


def _git(folder: Path, *arguments: str) -> str | None:
    command = ["git", "-C", str(folder), *arguments]
    try:
        process = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return process.stdout.strip() if process.returncode == 0 else None


def _text(path: Path) -> str | None:
    with suppress(OSError):
        return path.read_text(errors="replace").strip()
    return None


log = logging.getLogger("codecbench.store")


class EnvironmentFiles:
    """The environment descriptions in a folder, by environment id."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._sound: set[str] = set()

    def write(self, name: str, description: dict[str, Any]) -> None:
        """Write the description of this environment, unless there is a sound one."""
        if name in self._sound:
            return
        path = self._path(name)
        try:
            _description(name, read_plain(path))
        except (OSError, ValueError):
            body = {"id": name, "environment": description}
            document = {"checksum": digest(body), **body}
            write_file(path, json.dumps(document, indent=1, allow_nan=False).encode() + b"\n", durable=True)
        self._sound.add(name)

    def read(self) -> dict[str, dict[str, Any]]:
        """Return all sound descriptions, their texts cleaned; log a warning for each damaged one."""
        descriptions, damaged = self._read()
        for name, reason in damaged.items():
            log.warning("%s is damaged (%s) and is left out", self._path(name), reason)
        return descriptions

    def damaged(self) -> dict[str, str]:
        """Return why descriptions are damaged, by id."""
        return self._read()[1]

    def _read(self) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
        descriptions: dict[str, dict[str, Any]] = {}
        damaged: dict[str, str] = {}
        for path in sorted(self.folder.glob("*.json")):
            try:
                descriptions[path.stem] = clean_value(_description(path.stem, read_plain(path)))
            except (OSError, ValueError) as error:
                damaged[path.stem] = clean_line(str(error))
        return descriptions, damaged

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.json"


def _description(name: str, content: bytes) -> dict[str, Any]:
    """Parse the file of an environment. Raises ValueError if it is damaged or belongs to another one."""
    document = json_from_bytes(content)
    if not isinstance(document, dict):
        raise ValueError("it is not the description of an environment")
    description = document
    if document.keys() == {"checksum", "id", "environment"}:
        description = document["environment"]
        if digest({"id": document["id"], "environment": description}) != document["checksum"]:
            raise ValueError("its checksum does not match its content")
        if document["id"] != name:
            raise ValueError(f"it describes environment {document['id']}")
    elif environment_id(document) != name:  # without a checksum, as earlier versions wrote it
        raise ValueError("its content does not match its name")
    if not isinstance(description, dict) or not all(
        isinstance(description.get(part, {}), dict) for part in ("machine", "volatile")
    ):
        raise ValueError("it is not the description of an environment")
    return description

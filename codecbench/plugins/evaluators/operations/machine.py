"""Instructions that encoding and decoding one image execute, counted by callgrind in a child process."""

from __future__ import annotations

import importlib.util
import pickle
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.image import Image
from codecbench.core.counting.operations import OperationCounts
from codecbench.plugins.evaluators.operations.instructions import classified, object_code, read_profile, relocated

_CHILD = "codecbench.plugins.evaluators.operations.machine_child"
_TIMEOUT_S = 1800.0
_MAX_UNKNOWN_SHARE = 0.005
_CALLGRIND = (
    "--tool=callgrind",
    "--dump-instr=yes",
    "--instr-atstart=no",
    "--compress-strings=no",
    "--compress-pos=no",
    "--quiet",
)


def missing() -> str | None:
    """Why instructions cannot be counted here, and what to install; None where they can."""
    if platform.machine() not in ("x86_64", "AMD64"):
        return f"machine counts need an x86-64 processor, this is {platform.machine()}"
    if shutil.which("valgrind") is None:
        return "valgrind is not installed: apt-get install valgrind"
    modules = [name for name in ("iced_x86", "elftools") if importlib.util.find_spec(name) is None]
    return f"{' and '.join(modules)} not installed: pip install 'codecbench[machine]'" if modules else None


def executed(codec: AnyCodec[Any], image: Image) -> dict[str, OperationCounts]:
    """Operations of one encoding and one decoding, under `encode` and `decode`.

    The codec is prepared for the image, so no search for a rate is counted. Both have run once before, so no
    compilation and no loading is. The instructions of the Python interpreter itself are left out; those of every
    library and of compiled kernels are in.
    """
    with tempfile.TemporaryDirectory(prefix="codecbench-machine-") as name:
        folder = Path(name)
        (folder / "task.pickle").write_bytes(pickle.dumps((type(codec), codec.params, image)))
        command = ["valgrind", *_CALLGRIND, f"--callgrind-out-file={folder / 'profile'}", sys.executable, "-m", _CHILD]
        run = subprocess.run([*command, name], capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        if run.returncode != 0:
            raise RuntimeError(f"valgrind ended with status {run.returncode}: {run.stderr.strip()[-2000:]}")
        kernels = pickle.loads((folder / "kernels.pickle").read_bytes())
        return {
            direction: _counted(folder / f"profile.{number}", kernels)
            for number, direction in enumerate(("encode", "decode"), start=1)
        }


def _counted(profile: Path, kernels: list[tuple[int, bytes]]) -> OperationCounts:
    with profile.open() as lines:
        objects = read_profile(lines)
    code = {name: object_code(Path(name)) if Path(name).is_file() else kernels for name in objects}
    total, unknown, everything = OperationCounts(), 0, 0
    for name, addresses in relocated(objects, code).items():
        if _is_interpreter(name):
            continue
        counts, lost = classified(addresses, code[name])
        total, unknown = total + counts, unknown + lost
        everything += addresses.total()
    if unknown > _MAX_UNKNOWN_SHARE * everything:
        raise RuntimeError(f"{unknown} of {everything} executed instructions lie in no known code")
    return total


def _is_interpreter(name: str) -> bool:
    file = Path(name)
    return file.name.startswith("libpython") or (file.is_file() and file.samefile(sys.executable))

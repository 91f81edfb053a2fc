"""What the commands of README.md print and how long they take, for somebody who follows it in a new clone.

python docs/newcomer.py --recording FOLDER > newcomer.json
python docs/tables.py --printed newcomer=newcomer.json

runs them in their order, with this Python as `python3` and no compiled kernel, and shows on standard error what they
print. It stops with exit status 1 when one fails. Without a recording, the block of commands about PATH is left out.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from datetime import date
from itertools import chain
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recording", type=Path, metavar="FOLDER", help="what to put in the place of PATH")
    recording: Path | None = parser.parse_args().recording
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(list(followed(Path(folder), recording)), indent=1))


def commands(readme: str, recording: Path | None) -> list[str]:
    """The lines of the code blocks that name no language."""
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    blocks = [block for language, block in fenced if not language and (recording or " PATH\n" not in block)]
    lines = [line for block in blocks for line in block.splitlines()]
    return [re.sub(r" PATH$", f" {recording.name}", line) if recording else line for line in lines]


def followed(folder: Path, recording: Path | None) -> Iterator[dict[str, object]]:
    """Each command with its output, and the seconds that it took by the clock."""
    clone = folder / "codecbench"
    subprocess.run(["git", "clone", "-q", ROOT, clone], check=True)
    (folder / "bin").mkdir()
    (folder / "bin" / "python3").symlink_to(Path(sys.executable).resolve())
    environment = os.environ | {"PATH": f"{folder}/bin:{os.environ['PATH']}", "CODECBENCH_CACHE": f"{folder}/cache"}
    for name in ("CODECBENCH_DATA", "NUMBA_CACHE_DIR", "VIRTUAL_ENV"):
        environment.pop(name, None)
    if recording:
        (clone / recording.name).symlink_to(recording.resolve())
    for command in commands((clone / "README.md").read_text(), recording):
        begun = time.monotonic()
        done = subprocess.run(["bash", "-c", command], cwd=clone, env=environment, capture_output=True, text=True)
        seconds = time.monotonic() - begun
        print(f"$ {command}\n{done.stdout}{done.stderr}{seconds:.0f} s", file=sys.stderr)
        if done.returncode:
            raise SystemExit(1)
        yield {"command": command, "seconds": seconds, "output": done.stdout, "on": machine()}


def machine() -> str:
    """`2 cores (AMD EPYC), Python 3.13.0, 2026-11-27`."""
    cpu = re.search(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    model = cpu[1] if cpu else platform.machine()
    return f"{os.cpu_count()} cores ({model}), Python {platform.python_version()}, {date.today()}"


def ended(command: str, shown: str) -> Callable[[str, tuple[str, ...]], Iterator[str]]:
    """The part of a command's output that a pattern finds, after how long it took and where."""

    def content(text: str, heads: tuple[str, ...]) -> Iterator[str]:
        (found,) = [entry for entry in json.loads(text) if command in entry["command"]]
        minutes, seconds = divmod(round(found["seconds"]), 60)
        (part,) = re.findall(shown, found["output"], re.DOTALL)
        yield f"It took {minutes} min {seconds} s on {found['on']}, and printed:\n"
        yield from transcript(part, heads)

    return content


def transcript(text: str, _: tuple[str, ...]) -> Iterator[str]:
    """What a command printed, with long lines broken as a terminal breaks them, so that no page cuts them."""
    lines = [textwrap.wrap(line, 90, subsequent_indent="  ") or [""] for line in text.strip().splitlines()]
    yield "\n".join(["```text", *chain(*lines), "```"])


if __name__ == "__main__":
    main()

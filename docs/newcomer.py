"""What the commands of README.md print and how long they take, for somebody who follows it in a new clone.

python docs/newcomer.py --recording FOLDER > newcomer.json

runs them in their order, with this Python as `python3` and no compiled kernel, and shows on standard error what they
print. It stops with exit status 1 when one fails. Without a recording, the block of commands about PATH is left out.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
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
        yield {"command": command, "seconds": seconds, "output": done.stdout}


if __name__ == "__main__":
    main()

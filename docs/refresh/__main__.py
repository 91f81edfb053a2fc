"""Make the blocks of results in README.md and docs/ again, by the matrices and scripts that their numbers come from.

python docs/refresh [JOB...]      these, or all; what is there already is not computed again
python docs/refresh --check       exit status 1 if a block was made by other versions of plugins than today's

It takes the extras test and orbslam3. CODECBENCH_DATA names the folder of fr3_office_715, fr3_png16, kitti00_half,
sevenscenes_400 and kodak. Cut, it goes on with the same command. A script runs again if its plugins have other
versions, or if its file in the folder of --work is gone.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

import jobs


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=f"of {', '.join(jobs.NAMES)}")
    parser.add_argument("--check", action="store_true", help="run and write nothing")
    parser.add_argument("--work", type=Path, default=jobs.ROOT / "runs" / "refresh", metavar="FOLDER")
    chosen = parser.parse_args()
    if chosen.check:
        found = list(jobs.check())
        print("\n".join(found) or f"all {len(jobs.BLOCKS)} blocks are of today's plugins")
        return 1 if found else 0
    if unknown := set(chosen.jobs) - set(jobs.NAMES):
        parser.error(f"no job {', '.join(sorted(unknown))}; there are {', '.join(jobs.NAMES)}")
    work = chosen.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    todo = dict.fromkeys(chosen.jobs or jobs.NAMES)
    status = 0
    for name in list(todo):
        begun = time.monotonic()
        try:
            jobs.run(name, work)
        except (subprocess.CalledProcessError, OSError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            status = 1
            continue
        print(f"{name}: {time.monotonic() - begun:.0f} s", file=sys.stderr)
        del todo[name]
        for block in jobs.writable(name, work, todo):
            print(f"{jobs.BLOCKS[block].page}: {block}: {'written' if jobs.write(block, work) else 'same'}", flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())

"""Fuzz our decoders.

    python tests/fuzz/fuzz_decoders.py mutation jpeg_qf multilevel --seconds 300 --seed 1
    python tests/fuzz/fuzz_decoders.py coverage jpeg_qf --seconds 300

`mutation` runs the compiled kernels with bounds checks. `coverage` runs the same kernels as plain Python, where
atheris sees which branches an input takes; it is slower, and inputs that take the interpreter long are let go.
What a run finds is written to `--findings` and, once fixed, belongs into `tests/fuzz/corpus/<codec>/`.
"""

from __future__ import annotations

import argparse
import faulthandler
import hashlib
import json
import os
import signal
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any, NoReturn

_SHAPES = ((1, 1), (9, 17), (9, 17, 3), (24, 40), (24, 40, 3))
_SMALL_SHAPES = ((1, 1), (9, 17), (8, 9, 3))
_INTERPRETER_TIME_S = 3
_MAX_BYTES = 2000


class _Slow(BaseException):
    """The interpreter took too long over an input."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("engine", choices=["mutation", "coverage"])
    parser.add_argument("codecs", nargs="+")
    parser.add_argument("--seconds", type=int, default=60, help="for each codec")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--findings", type=Path, default=Path("fuzz-findings"))
    arguments = parser.parse_args()
    arguments.findings.mkdir(parents=True, exist_ok=True)
    faulthandler.enable()
    if arguments.engine == "mutation":
        os.environ["NUMBA_BOUNDSCHECK"] = "1"
        for name in arguments.codecs:
            _mutate(name, arguments)
        return
    if len(arguments.codecs) != 1:
        parser.error("coverage takes one codec, because its engine ends the process")
    os.environ["NUMBA_DISABLE_JIT"] = "1"
    _follow_coverage(arguments.codecs[0], arguments)


def _mutate(name: str, arguments: argparse.Namespace) -> None:
    from decoder_targets import TARGETS
    from mutation import fuzz

    target = TARGETS[name]
    seeds = target.seeds(_SHAPES) + _kept(name)
    last_input = arguments.findings / f"{name}-last-input"
    campaign = fuzz(target, seeds, arguments.seed, last_input, seconds=arguments.seconds)
    for data in campaign.findings.values():
        _keep(name, data, arguments.findings)
    summary = {
        "codec": name,
        "seconds": arguments.seconds,
        "cpu_seconds": round(campaign.cpu_s),
        "seed": arguments.seed,
        "inputs": campaign.inputs,
        "pool": campaign.pool,
        "slowest_s": round(campaign.slowest_s, 3),
        "largest_mib": campaign.largest_bytes >> 20,
        "findings": list(campaign.findings),
        "verdicts": dict(campaign.verdicts.most_common(15)),
    }
    sys.stdout.write(json.dumps(summary, indent=1) + "\n")


def _follow_coverage(name: str, arguments: argparse.Namespace) -> NoReturn:
    import atheris

    with atheris.instrument_imports(include=["codecbench.plugins.codecs"], enable_loader_override=False):
        from decoder_targets import TARGETS

        target = TARGETS[name]
        codec = target.codec()
    from limits import Finding, judge

    warnings.simplefilter("ignore")  # numpy's scalars warn where machine integers wrap around

    def test_one_input(data: bytes) -> None:
        repaired = target.repair(data)
        signal.alarm(_INTERPRETER_TIME_S)
        try:
            judge(codec, repaired)
        except _Slow:
            pass
        except Finding:
            _keep(name, repaired, arguments.findings)
            raise
        finally:
            signal.alarm(0)

    signal.signal(signal.SIGALRM, _give_up)
    folder = Path(tempfile.mkdtemp(prefix="codecbench-fuzz-"))
    sys.stdout.write(f"coverage of {name} for {arguments.seconds} s\n")
    sys.stdout.flush()
    for number, data in enumerate(target.seeds(_SMALL_SHAPES) + _kept(name)):
        (folder / f"seed-{number}").write_bytes(data)
    options = [f"-max_total_time={arguments.seconds}", f"-max_len={_MAX_BYTES}", f"-seed={arguments.seed}"]
    options += [f"-artifact_prefix={arguments.findings}/{name}-", "-timeout=120", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], *options, str(folder)], test_one_input)
    atheris.Fuzz()
    raise SystemExit


def _give_up(*_: Any) -> NoReturn:
    raise _Slow


def _keep(name: str, data: bytes, folder: Path) -> None:
    (folder / f"{name}-{hashlib.sha256(data).hexdigest()[:12]}").write_bytes(data)


def _kept(name: str) -> list[bytes]:
    return [path.read_bytes() for path in sorted((Path(__file__).parent / "corpus" / name).glob("*"))]


if __name__ == "__main__":
    main()

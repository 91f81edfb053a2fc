"""Benchmarks of codecs under pytest-benchmark, for the repositories of codec authors.

    pytest --codecbench "mine quality=50" --benchmark-autosave --benchmark-compare --benchmark-compare-fail=min:5%

times encoding and decoding of that setting (several `--codecbench` options give several; without a value, of every
installed image codec at its example settings). A codec's search on the image runs before and is not timed.
Size, PSNR, operation counts and the codec's version go into `extra_info` of pytest-benchmark. With
`--codecbench-baseline FILE`, a larger size, a lower PSNR or more operations fails the test. So does a time, in units of
a yardstick timed in between, that is more than `--codecbench-slower` per cent longer. Missing settings are added to the
file.

Your own tests can use the fixture `codec_under_test`; each runs once for each setting.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from codecbench.pytesting import ALL

if TYPE_CHECKING:
    from codecbench.pytesting.baseline import Baseline
    from codecbench.pytesting.cases import CodecCase

_CASE_FIXTURE = "codec_under_test"
_CASES = pytest.StashKey["list[CodecCase]"]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("codecbench", "benchmarks of codecs")
    group.addoption(
        "--codecbench",
        action="append",
        nargs="?",
        const=ALL,
        default=[],
        metavar="'NAME KEY=VALUE ...'",
        help="benchmark this codec setting; without a value, every installed codec",
    )
    group.addoption(
        "--codecbench-baseline",
        metavar="FILE",
        help="JSON file of sizes, PSNRs, operations and relative times to compare with; missing entries are added",
    )
    group.addoption(
        "--codecbench-slower",
        metavar="PERCENT",
        type=float,
        default=7.0,
        help="allowed slowdown of encoding or decoding against the baseline (default: 7)",
    )


def pytest_configure(config: pytest.Config) -> None:
    wanted = config.getoption("--codecbench")
    if wanted:
        config.stash[_CASES] = [case for text in wanted for case in _cases(text)]
        config.args.append(str(Path(__file__).parent / "benchmarks.py"))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if _CASE_FIXTURE in metafunc.fixturenames:
        cases = metafunc.config.stash.get(_CASES, None) or _cases(ALL)
        metafunc.parametrize(_CASE_FIXTURE, cases, ids=[case.name for case in cases])


@pytest.fixture(scope="session")
def codec_baseline(request: pytest.FixtureRequest) -> Iterator[Baseline]:
    """The file of `--codecbench-baseline`; the end of the session adds missing entries."""
    from codecbench.pytesting.baseline import open_baseline  # this plugin is loaded by every pytest run

    option = request.config.getoption("--codecbench-baseline")
    baseline = open_baseline(Path(option) if option else None, request.config.getoption("--codecbench-slower"))
    yield baseline
    try:
        baseline.save()
    except OSError as error:
        pytest.fail(f"{error}: new entries were not added to the baseline", pytrace=False)


def _cases(text: str) -> list[CodecCase]:
    """Return the cases of one `--codecbench` value. Raises pytest.UsageError if it cannot be understood."""
    from codecbench.pytesting.cases import codec_cases  # this plugin is loaded by every pytest run

    return codec_cases(text)

"""Benchmarks of codecs under pytest-benchmark, for the repositories of codec authors.

    pytest --codecbench "mine quality=50" --benchmark-autosave --benchmark-compare --benchmark-compare-fail=min:5%

times encoding and decoding of that setting (several `--codecbench` options give several; without a value, of every
installed codec of single pictures at its example settings); what a codec searches for on the picture is found before.
Size, PSNR, operation counts and the codec's version go into `extra_info` of pytest-benchmark, and with
`--codecbench-baseline FILE` all are compared as well: a larger file, a loss of quality or one operation more fails the
test whatever the clock says, and so does a time, in units of a yardstick timed in between, that is more than
`--codecbench-slower` per cent longer. Settings that the file lacks are added to it.

A test of your own asks for the fixture `codec_under_test` and is run once for each setting.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from codecbench.core.contracts.codec import Codec
    from codecbench.core.contracts.image import Image
    from codecbench.pytesting.baseline import Baseline

ALL = "*"
_CASE_FIXTURE = "codec_under_test"


@dataclass(frozen=True)
class CodecCase:
    """One codec setting beside the picture that it is benchmarked on."""

    name: str
    codec: Codec[Any]
    image: Image

    @cached_property
    def prepared(self) -> Codec[Any]:
        """The codec with what it searches for on this picture already found."""
        return self.codec.prepared(self.image)

    def facts(self) -> dict[str, Any]:
        """What is recorded beside the times: version, size, PSNR, and operation counts where the codec counts them."""
        from codecbench.core.counting.trace import CountingTrace
        from codecbench.plugins.evaluators.fidelity import psnr_db

        bitstream = self.prepared.encode(self.image)
        facts: dict[str, Any] = {
            "codec": self.name,
            "version": self.codec.version,
            "size_bytes": len(bitstream),
            "psnr_db": psnr_db(self.image, self.codec.decode(bitstream)),
        }
        if self.codec.capabilities.counts_operations:
            for direction, work in (("encode", lambda trace: self.prepared.encode(self.image, trace=trace)),
                                    ("decode", lambda trace: self.codec.decode(bitstream, trace=trace))):  # fmt: skip
                trace = CountingTrace()
                work(trace)
                facts[f"{direction}_operations"] = int(sum(counts.total for counts in trace.counts.values()))
        return facts


_CASES = pytest.StashKey[list[CodecCase]]()


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
        help="a JSON file of sizes, PSNRs, operations and relative times: compared with what it has; the rest is added",
    )
    group.addoption(
        "--codecbench-slower",
        metavar="PERCENT",
        type=float,
        default=7.0,
        help="how much longer than in the baseline encoding or decoding may take (default: 7)",
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
    """The file of `--codecbench-baseline`, with what it lacks added at the end of the session."""
    from codecbench.core.engine.storage.environment import describe_machine
    from codecbench.pytesting.baseline import Baseline

    option = request.config.getoption("--codecbench-baseline")
    processor = str(describe_machine()["cpu"])
    baseline = Baseline(Path(option) if option else None, request.config.getoption("--codecbench-slower"), processor)
    yield baseline
    try:
        baseline.save()
    except OSError as error:
        pytest.fail(f"{error}: what the baseline lacks was not added to it", pytrace=False)


def _cases(text: str) -> list[CodecCase]:
    """The cases of one `--codecbench` value. Raises pytest.UsageError for what cannot be understood."""
    from pydantic import ValidationError

    from codecbench.core.conformance.settings import setting_from_text, setting_label
    from codecbench.core.contracts.errors import CodecbenchError, Unsupported
    from codecbench.core.engine.plugins.registry import installed, loads

    registry = installed()
    name, _, rest = text.strip().partition(" ")
    cases = []
    for plugin in registry.plugins("codec") if name == ALL else [None]:
        if plugin is not None and plugin.missing is not None:
            continue
        chosen = plugin.spec.name if plugin is not None else name
        try:
            registry.ask(loads, "codec", chosen, of=[("codec", chosen)])  # what ends its process ends another
            cls = registry.load("codec", chosen)
            if not cls.stateless:
                raise Unsupported(f"{chosen} codes sequences; these benchmarks are of single pictures")
            for example in [setting_from_text(rest)] if rest else cls.examples:
                codec = cls(cls.params_type.model_validate(example))
                cases.append(CodecCase(setting_label(chosen, example), codec, _picture(cls)))
        except Unsupported as error:
            if plugin is None:
                raise pytest.UsageError(f"--codecbench {text}: {error}") from None
        except (CodecbenchError, ValidationError) as error:
            if plugin is not None and plugin.hosted:
                warnings.warn(pytest.PytestWarning(f"--codecbench leaves out {error}"), stacklevel=1)
                continue
            raise pytest.UsageError(f"--codecbench {text}: {error}") from None
    return cases


def _picture(cls: type[Codec[Any]]) -> Image:
    """A 640x480 photograph, in colour where the codec takes colour."""
    import cv2
    import numpy as np
    import skimage.data

    from codecbench.core.contracts.image import gray_from_image

    photograph = skimage.data.astronaut()  # type: ignore[no-untyped-call]
    image = np.asarray(cv2.resize(photograph, (640, 640), interpolation=cv2.INTER_CUBIC), np.uint8)[80:560]
    image = np.ascontiguousarray(image)
    return image if 3 in cls.capabilities.channels else gray_from_image(image)

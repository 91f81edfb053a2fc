"""Benchmarks of codecs under pytest-benchmark, for the repositories of codec authors.

    pytest --codecbench "mine quality=50" --benchmark-autosave --benchmark-compare --benchmark-compare-fail=min:5%

times encoding and decoding of that setting (several `--codecbench` options give several; without a value, of every
installed codec at its example settings). Size, PSNR, operation counts and the codec's version go into `extra_info` of
pytest-benchmark, and with `--codecbench-baseline FILE` size and PSNR are compared as well: a larger file or a loss of
quality fails the test whatever the clock says. Settings that the file does not have yet are added to it.

A test of your own asks for the fixture `codec_under_test` and is run once for each setting.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from codecbench.core.contracts.codec import Codec
    from codecbench.core.contracts.image import Image

ALL = "*"
_CASE_FIXTURE = "codec_under_test"


@dataclass(frozen=True)
class CodecCase:
    """One codec setting beside the picture that it is benchmarked on."""

    name: str
    codec: Codec[Any]
    image: Image

    def facts(self) -> dict[str, Any]:
        """What is recorded beside the times: version, size, PSNR, and operation counts where the codec counts them."""
        from codecbench.core.instrument.trace import CountingTrace

        bitstream = self.codec.encode(self.image)
        facts: dict[str, Any] = {
            "codec": self.name,
            "version": self.codec.version,
            "size_bytes": len(bitstream),
            "psnr_db": psnr_db(self.image, self.codec.decode(bitstream)),
        }
        if self.codec.capabilities.counts_operations:
            for direction, work in (("encode", lambda t: self.codec.encode(self.image, trace=t)),
                                    ("decode", lambda t: self.codec.decode(bitstream, trace=t))):  # fmt: skip
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
        help="a JSON file of sizes and PSNRs: what it has is compared exactly, what it has not is added",
    )


def pytest_configure(config: pytest.Config) -> None:
    wanted = config.getoption("--codecbench")
    if wanted:
        config.stash[_CASES] = [case for text in wanted for case in _cases(text)]
        config.args.append(str(Path(__file__).parent / "codec_benchmarks.py"))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if _CASE_FIXTURE in metafunc.fixturenames:
        cases = metafunc.config.stash.get(_CASES, None) or _cases(ALL)
        metafunc.parametrize(_CASE_FIXTURE, cases, ids=[case.name for case in cases])


@pytest.fixture(scope="session")
def codec_baseline(request: pytest.FixtureRequest) -> Any:
    """A function that compares the facts of a case with the baseline file, or adds them to it."""
    option = request.config.getoption("--codecbench-baseline")
    path = Path(option) if option else None
    known: dict[str, Any] = json.loads(path.read_text()) if path is not None and path.exists() else {}
    added: dict[str, Any] = {}

    def check(facts: dict[str, Any]) -> None:
        before = known.get(facts["codec"])
        if before is None:
            added[facts["codec"]] = {key: facts[key] for key in ("version", "size_bytes", "psnr_db")}
            return
        if facts["size_bytes"] > before["size_bytes"]:
            pytest.fail(f"{facts['codec']}: {facts['size_bytes']} bytes; the baseline has {before['size_bytes']}")
        if facts["psnr_db"] < before["psnr_db"]:
            pytest.fail(f"{facts['codec']}: PSNR {facts['psnr_db']} dB; the baseline has {before['psnr_db']} dB")

    yield check
    if path is not None and added:
        path.write_text(json.dumps({**known, **added}, indent=2) + "\n")


def psnr_db(first: Image, second: Image) -> float:
    """Peak signal-to-noise ratio over all samples, in dB; infinite for equal images."""
    import numpy as np

    error = float(np.mean((first.astype(np.float64) - second) ** 2))
    return float("inf") if error == 0 else float(10 * np.log10(255.0**2 / error))


def _cases(text: str) -> list[CodecCase]:
    """The cases of one `--codecbench` value. Raises pytest.UsageError for what cannot be understood."""
    from pydantic import ValidationError

    from codecbench.core.conformance.settings import setting_from_text, setting_label
    from codecbench.core.contracts.errors import CodecbenchError, Unsupported
    from codecbench.core.engine.registry import installed

    registry = installed()
    name, _, rest = text.strip().partition(" ")
    cases = []
    for plugin in registry.plugins("codec") if name == ALL else [None]:
        if plugin is not None and plugin.missing is not None:
            continue
        chosen = plugin.offer.name if plugin is not None else name
        try:
            cls = registry.load("codec", chosen)
            for example in [setting_from_text(rest)] if rest else cls.examples:
                codec = cls(cls.params_type.model_validate(example))
                cases.append(CodecCase(setting_label(chosen, example), codec, _picture(cls)))
        except Unsupported as error:
            if plugin is None:
                raise pytest.UsageError(f"--codecbench {text}: {error}") from None
        except (CodecbenchError, ValidationError) as error:
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

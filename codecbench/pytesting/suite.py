"""The conformance checks as a pytest suite, to be inherited in a codec author's repository.

    from codecbench.pytesting import CodecSuite
    from my_package import MyCodec

    class TestMyCodec(CodecSuite):
        codec = MyCodec
        settings = [{}, {"quality": 90}]

Every check is a test of its own, run for each setting and each layout that the codec accepts; a StreamCodec gets the
checks for video codecs, a FeatureCodec those for feature codecs. The codec must be importable by its
module's name in another process, as an installed package is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import pytest

from codecbench.core.conformance.harness import Check, shape_of
from codecbench.core.conformance.settings import setting_label
from codecbench.core.conformance.suite import checks_of, run_checks
from codecbench.core.contracts.codec import AnyCodec

__all__ = ["CodecSuite"]


class CodecSuite:
    """Base class of a codec's tests. A subclass that names its codec gets a test `test_<check>` for each check."""

    codec: ClassVar[type[AnyCodec[Any]]]
    """The class to check."""
    settings: ClassVar[Sequence[dict[str, Any]]] = ()
    """Parameters of the settings to check; by default the codec's `examples`."""

    def __init_subclass__(cls) -> None:
        """Add the tests for the codec's shape to the class."""
        super().__init_subclass__()
        codec = getattr(cls, "codec", None)
        for check in () if codec is None else checks_of(shape_of(codec)):
            if not hasattr(cls, f"test_{check.name}"):
                setattr(cls, f"test_{check.name}", _make_test(check))

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Run each test of the class once for each setting."""
        if "setting" in metafunc.fixturenames:
            settings = list(self.settings or self.codec.examples)
            metafunc.parametrize(
                "setting", settings, ids=[setting_label("", setting) or "defaults" for setting in settings]
            )


def _make_test(check: Check) -> Callable[[CodecSuite, dict[str, Any]], None]:
    def test(self: CodecSuite, setting: dict[str, Any]) -> None:
        results = run_checks(self.codec, self.codec.params_type.model_validate(setting), [check])
        failures = [f"{result.layout}: {result.reason}" for result in results if result.status == "failed"]
        if failures:
            pytest.fail(f"{check.proves}\n" + "\n".join(failures), pytrace=False)
        if all(result.status == "skipped" for result in results):
            pytest.skip(results[0].reason)

    test.__name__ = f"test_{check.name}"
    test.__qualname__ = f"{CodecSuite.__qualname__}.{test.__name__}"
    test.__doc__ = f"Check that {check.proves}."
    return test

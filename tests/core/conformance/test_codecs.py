"""Every installed codec keeps the contract, at each of its example settings.

Quick are most checks at a codec's first example, and at the others those whose answer the setting changes most. Of
codecs that differ in their library's function and settings alone, one has them; the checks that start processes or take
many bitstreams apart, one codec of pictures and one of streams.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import pytest

from codecbench.core.conformance import damage, sandbox
from codecbench.core.conformance.harness import Check, shape_of
from codecbench.core.conformance.settings import setting_label
from codecbench.core.conformance.suite import checks_of, films_of
from codecbench.core.engine.plugins.registry import installed

SLOW_CHECKS = ("bombs", "cut", "damaged", "deterministic", "future", "self_contained", "threads")
HAVE_SLOW_CHECKS = ("h264", "multilevel")
CHECKS_OF_EVERY_SETTING = ("params", "bytes", "lossless")
ALIKE = {"jpegls": "avif", "jpegxl": "avif", "webp": "avif"}
ALIKE |= {"lz4": "zstd"}
ALIKE |= {"av1": "h264", "ffv1": "h264", "hevc": "h264", "mjpeg": "h264", "vp9": "h264"}
"""Codecs whose methods are those of another, which has all checks."""
OTHER_BITSTREAMS = [{"qf": 2, "profile": "context"}]
"""Settings that have a bitstream of their own, and so are checked like a codec."""
NAMES = [plugin.spec.name for plugin in installed().plugins("codec")]


def _cases() -> Iterator[Any]:
    """Every check at every example setting of every codec, but for claims that the setting does not make."""
    for name in NAMES:
        if installed().find("codec", name).missing is not None:
            continue
        codec_class = installed().load("codec", name)
        for setting in codec_class.examples:
            claims = {
                "lossless": codec_class(codec_class.params_type(**setting)).is_lossless(),
                "threads": codec_class.capabilities.thread_safe,
                "partial": codec_class.capabilities.partial_decoding,
                "one_in_one_out": codec_class(codec_class.params_type(**setting)).is_low_delay(),
            }
            for check in checks_of(shape_of(codec_class)):
                if claims.get(check.name, True):
                    is_first = setting == codec_class.examples[0] or setting in OTHER_BITSTREAMS
                    if codec_class.stateless or name in ALIKE:
                        has_all = is_first and name not in ALIKE and check.name != "counting"
                        is_slow = not (has_all or check.name in CHECKS_OF_EVERY_SETTING)
                    else:
                        is_slow = not is_first
                    is_slow |= check.name in SLOW_CHECKS and name not in HAVE_SLOW_CHECKS
                    marks = [pytest.mark.thorough] if is_slow else []
                    label = setting_label(name, setting).replace(" ", "-")
                    yield pytest.param(name, setting, check, id=f"{label}-{check.name}", marks=marks)


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels may be compiled meanwhile, and the machine may be busy: only what hangs takes so long."""
    monkeypatch.setattr(damage, "_TIMEOUT_S", 300.0)
    monkeypatch.setattr(sandbox, "_START_TIMEOUT_S", 300.0)


@pytest.mark.parametrize(("name", "setting", "check"), list(_cases()))
def test_codec_keeps_the_contract(name: str, setting: dict[str, Any], check: Check) -> None:
    codec_class = installed().load("codec", name)
    for layout in codec_class.capabilities.layouts:
        check.function(codec_class, codec_class.params_type(**setting), films_of(shape_of(codec_class), layout))


@pytest.mark.parametrize("name", NAMES)
def test_a_codec_is_available_or_says_what_to_install(name: str) -> None:
    missing = installed().find("codec", name).missing
    assert missing is None or "pip install" in missing


@pytest.mark.parametrize(("name", "other"), ALIKE.items())
def test_codecs_that_are_alike_share_their_methods(name: str, other: str) -> None:
    codec_class, base = installed().load("codec", name), installed().load("codec", other).__base__
    assert codec_class.__base__ is base
    assert base is not None
    own = {member for member, value in vars(codec_class).items() if inspect.isfunction(value)}
    assert own <= {"_arguments", "is_lossless", "_other_recipes"}, "none that codes"


def test_our_codecs_are_all_here() -> None:
    assert {"raw", "png", "jpeg", "jpeg_qf", "jpeg2000", "multilevel"} <= set(NAMES)

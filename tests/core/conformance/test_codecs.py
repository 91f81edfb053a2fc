"""Every installed codec keeps the contract, at each of its example settings."""

from __future__ import annotations

from typing import Any

import pytest

from codecbench.core.conformance.failure import NotClaimed
from codecbench.core.conformance.images import conformance_images
from codecbench.core.conformance.settings import setting_label
from codecbench.core.conformance.suite import CHECKS, Check
from codecbench.core.engine.registry import installed

NAMES = [plugin.spec.name for plugin in installed().plugins("codec")]
CASES = [
    pytest.param(name, setting, id=setting_label(name, setting).replace(" ", "-"))
    for name in NAMES
    if installed().find("codec", name).missing is None
    for setting in installed().load("codec", name).examples
]
CHECKED = [
    pytest.param(check, id=check.name, marks=[pytest.mark.thorough] if check.name == "counting" else [])
    for check in CHECKS
]


@pytest.mark.parametrize("check", CHECKED)
@pytest.mark.parametrize(("name", "setting"), CASES)
def test_codec_keeps_the_contract(name: str, setting: dict[str, Any], check: Check) -> None:
    codec_class = installed().load("codec", name)
    for channels in codec_class.capabilities.channels:
        try:
            check.function(codec_class, codec_class.params_type(**setting), conformance_images(channels))
        except NotClaimed as claim:
            pytest.skip(str(claim))


@pytest.mark.parametrize("name", NAMES)
def test_codec_is_available(name: str) -> None:
    missing = installed().find("codec", name).missing
    if missing is not None:
        pytest.skip(missing)


def test_our_codecs_are_all_here() -> None:
    assert {"raw", "png", "jpeg", "jpeg_qf", "jpeg2000", "multilevel"} <= set(NAMES)

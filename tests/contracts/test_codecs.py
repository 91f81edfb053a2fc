"""Every installed codec keeps the contract, at several settings."""

from __future__ import annotations

from typing import Any

import pytest
from codec_settings import label, settings_of

from codecbench.core.conformance.images import conformance_images
from codecbench.core.conformance.suite import CHECKS, Check
from codecbench.core.engine.registry import installed

CASES = [
    pytest.param(plugin.offer.name, setting, id=label(plugin.offer.name, setting))
    for plugin in installed().plugins("codec")
    for setting in settings_of(plugin.offer.name)
]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
@pytest.mark.parametrize(("name", "setting"), CASES)
def test_codec_keeps_the_contract(name: str, setting: dict[str, Any], check: Check) -> None:
    missing = installed().find("codec", name).missing
    if missing is not None:
        pytest.skip(missing)
    codec_class = installed().load("codec", name)
    for channels in codec_class.capabilities.channels:
        check.function(codec_class, codec_class.params_type(**setting), conformance_images(channels))


def test_our_codecs_are_all_here() -> None:
    names = {plugin.offer.name for plugin in installed().plugins("codec")}
    assert {"raw", "png", "jpeg", "jpeg_qf", "jpeg2000", "multilevel"} <= names

"""A worker notices when code of others changed what it computes with."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest

from codecbench.core.contracts import image as images
from codecbench.core.engine.registry import registry_of
from codecbench.core.engine.running.sentinel import KnownCoded, Sentinel, Tampering, known_measurements

COMPANY = ("stranger 1.0",)


@pytest.fixture(scope="module")
def sentinel() -> Sentinel:
    return Sentinel(registry_of(()))


def test_the_known_answer_of_psnr_is_what_plain_integers_give() -> None:
    quality = registry_of(()).create("evaluator", "quality", {})
    for index in range(2):
        original = KnownCoded().frame(index).original.image.tolist()
        squares = sum((value % 8) ** 2 for row in original for value in row)
        psnr = 10 * math.log10(255**2 * 96 * 128 / squares)
        measured = [m.value for m in known_measurements(quality) if m.metric == "psnr_gray_db" and m.frame == index]
        assert measured == [pytest.approx(psnr, rel=1e-12)]


def test_nothing_is_said_where_nothing_changed(sentinel: Sentinel) -> None:
    sentinel.check(COMPANY)


@pytest.mark.parametrize(
    ("owner", "name", "words"),
    [
        (np, "mean", "code of stranger 1.0 replaced numpy.mean"),
        (cv2, "resize", "replaced cv2.resize"),
        (math, "log10", "replaced math.log10"),
        (images, "gray_from_image", "replaced codecbench.core.contracts.image.gray_from_image"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_a_replaced_function_is_named(
    sentinel: Sentinel, monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, words: str
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(owner, name, lambda *_, **__: 42.0)
        with pytest.raises(Tampering, match=words):
            sentinel.check(COMPANY)
    sentinel.check(COMPANY)


def test_a_changed_answer_is_noticed_without_a_replaced_function(
    sentinel: Sentinel, monkeypatch: pytest.MonkeyPatch
) -> None:
    features = next(evaluator for evaluator in sentinel._evaluators if evaluator.name == "features")
    monkeypatch.setattr(features, "params", features.params.model_copy(update={"tolerance_px": 0.01}))
    with pytest.raises(Tampering, match="changed what evaluator features measures of a known picture"):
        sentinel.check(COMPANY)

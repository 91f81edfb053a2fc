"""The benchmarks that `pytest --codecbench` runs; see `codecbench.pytesting.plugin`."""

from __future__ import annotations

from typing import Any

import pytest

from codecbench.pytesting.baseline import Baseline
from codecbench.pytesting.cases import CodecCase


def test_encode(codec_under_test: CodecCase, benchmark: Any, codec_baseline: Baseline) -> None:
    case = codec_under_test
    facts = case.facts()
    benchmark.extra_info.update(facts)
    benchmark(case.prepared.encode, case.image)
    complaint = codec_baseline.complaint(facts)
    if not complaint and benchmark.enabled:
        complaint = codec_baseline.time_complaint(case.name, "encode", lambda: case.prepared.encode(case.image))
    if complaint:
        pytest.fail(complaint)


def test_decode(codec_under_test: CodecCase, benchmark: Any, codec_baseline: Baseline) -> None:
    case = codec_under_test
    bitstream = case.prepared.encode(case.image)
    benchmark.extra_info.update(case.facts())
    benchmark(case.codec.decode, bitstream)
    if benchmark.enabled:
        complaint = codec_baseline.time_complaint(case.name, "decode", lambda: case.codec.decode(bitstream))
        if complaint:
            pytest.fail(complaint)

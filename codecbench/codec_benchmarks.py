"""The benchmarks that `pytest --codecbench` runs; see `pytest_plugin`."""

from __future__ import annotations

from typing import Any

from codecbench.pytest_plugin import CodecCase


def test_encode(codec_under_test: CodecCase, benchmark: Any, codec_baseline: Any) -> None:
    facts = codec_under_test.facts()
    benchmark.extra_info.update(facts)
    benchmark(codec_under_test.codec.encode, codec_under_test.image)
    codec_baseline(facts)


def test_decode(codec_under_test: CodecCase, benchmark: Any) -> None:
    bitstream = codec_under_test.codec.encode(codec_under_test.image)
    benchmark.extra_info.update(codec_under_test.facts())
    benchmark(codec_under_test.codec.decode, bitstream)

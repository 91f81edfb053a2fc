"""Pairs of real runs, compared: equal code raises no alarm, and a little more work or a little less quality does."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import distributions
import pytest
from engine_bench import Bench, bench_in

from codecbench.core.analysis.comparison import Comparison, Snapshot, compare, read_snapshot

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

PLUGIN = '''
import os
import zlib

import numpy as np

from codecbench import Capabilities, Codec, NoParams, PluginSpec, hookimpl


class Trial(Codec):
    """Codes as the environment says: TRIAL_WORK pieces of work a frame, TRIAL_LOSS of the pixels off by one."""

    name = "trial"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities()
    examples = ({},)

    def encode(self, image, *, trace=None):
        for _ in range(int(os.environ["TRIAL_WORK"])):
            zlib.compress(bytes(range(256)) * 64, 6)
        return np.array(image.shape[:2], np.uint32).tobytes() + image.tobytes()

    def decode(self, bitstream, *, trace=None):
        shape = np.frombuffer(bitstream[:8], np.uint32)
        image = np.frombuffer(bitstream[8:], np.uint8).reshape(shape).copy()
        changed = image.reshape(-1)[: int(os.environ["TRIAL_LOSS"])]
        changed ^= 1
        return image


@hookimpl
def codecbench_codecs():
    return [PluginSpec("trial", "trial_plugin:Trial", "work and loss on demand")]
'''

MATRIX = """
version: 1
sequences: [{use: synthetic, params: {stop: 4, color: gray}}]
codecs: [trial]
evaluators: [quality, {use: timing, params: {frames: 3, repeats: 7}}]
"""


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path) as bench:
        distributions.install_source(bench.site, "trial-plugin", "1.0", PLUGIN)
        yield bench


def test_twenty_pairs_of_runs(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    names = itertools.count()

    def run(work: int, loss: int = 30_000) -> Snapshot:
        monkeypatch.setenv("TRIAL_WORK", str(work))
        monkeypatch.setenv("TRIAL_LOSS", str(loss))
        name = f"run{next(names)}"
        assert set(bench.run(MATRIX, name, workers=1).statuses) == {"ok"}
        return read_snapshot(bench.folder / name)

    def encoding(before: Snapshot, after: Snapshot) -> Comparison:
        (found,) = compare(before, after, metrics=["timing.encode_cpu_ms"])
        return found

    same = [run(200) for _ in range(21)]
    alarms = [one for pair in itertools.pairwise(same) for one in compare(*pair) if one.verdict in ("worse", "better")]
    slower = [encoding(before, run(220)) for before in same[:20]]
    assert alarms == []
    assert [one for one in slower if one.verdict != "worse"] == []
    lossy = compare(same[0], run(200, 30_700), metrics=["quality.psnr_gray_db"])  # 10 log10(307 / 300) = 0.1 dB
    assert {one.verdict for one in lossy} == {"worse"}

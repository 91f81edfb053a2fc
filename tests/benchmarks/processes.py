"""Whole-process timings as a Markdown table: medians of rounds in turn, by `python tests/benchmarks/processes.py`."""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import codecbench
from codecbench.core.engine.plugins.registry import installed

COMMANDS = {
    "python -c pass": [sys.executable, "-c", "pass"],
    "codecbench --help": [sys.executable, "-m", "codecbench", "--help"],
    "codecbench list": [sys.executable, "-m", "codecbench", "list"],
}
FIRST_RUN = [sys.executable, "-m", "codecbench", "run", "examples/first.yaml", "--out"]
MATRIX = """
version: 1
name: engine
sequences: [{{use: synthetic, params: {{stop: {frames}}}}}]
codecs: [{{use: jpeg, params: {{quality: 30}}}}]
evaluators: [quality]
run: {{workers: 1}}
"""


def starts(rounds: int) -> dict[str, float]:
    """Seconds that each command takes, the commands taking turns."""
    taken: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(rounds):
        for name, command in COMMANDS.items():
            begun = time.perf_counter()
            subprocess.run(command, capture_output=True, check=True)
            taken[name].append(time.perf_counter() - begun)
    return {name: statistics.median(values) for name, values in taken.items()}


def first_runs(rounds: int) -> dict[str, tuple[float, float]]:
    """Seconds to the first result and to the end of the first run, with an empty cache and then with a full one."""
    taken: dict[str, list[tuple[float, float]]] = {"empty": [], "full": []}
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            for cache, times in taken.items():
                environment = {**os.environ, "CODECBENCH_CACHE": folder}
                command = [*FIRST_RUN, f"{folder}/{cache}"]
                begun = time.perf_counter()
                pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
                with subprocess.Popen(command, env=environment, **pipes) as run:
                    said = [time.perf_counter() - begun for line in run.stderr if "; " in line]
                assert run.returncode == 0
                times.append((said[0], time.perf_counter() - begun))
    return {cache: tuple(map(statistics.median, zip(*times, strict=True))) for cache, times in taken.items()}


def engine_share(frames: int, rounds: int) -> float:
    """Frames per second of a quality cell over those of a bare loop with the same reads, codec and metric calls."""
    registry = installed()
    sequence = registry.create("dataset", "synthetic", {"stop": frames}).open()
    codec = registry.create("codec", "jpeg", {"quality": 30})
    bitstreams = [codec.encode(frame.image) for frame in sequence]
    quality = registry.create("evaluator", "quality", {})
    shares = []
    for turn in range(rounds + 1):
        begun = time.perf_counter()
        list(quality.evaluate(_Coded(sequence, codec, bitstreams), None))
        bare = time.perf_counter() - begun
        with tempfile.TemporaryDirectory() as folder:
            matrix = Path(folder) / "engine.yaml"
            matrix.write_text(MATRIX.format(frames=frames))
            run = codecbench.run(matrix, out=Path(folder) / "run")
            (result,) = run.results
            record = json.loads((result.folder / "record.json").read_text())
        if turn:  # the first warms caches
            shares.append(bare / record["duration_s"])
    return statistics.median(shares)


class _Coded:
    def __init__(self, sequence, codec, bitstreams) -> None:  # type: ignore[no-untyped-def]
        self.sequence, self.codec, self._bitstreams = sequence, codec, bitstreams

    def __len__(self) -> int:
        return len(self._bitstreams)

    def size_bytes(self, index: int) -> int:
        return len(self._bitstreams[index])

    def frame(self, index: int) -> codecbench.CodedFrame:
        bitstream = self._bitstreams[index]
        return codecbench.CodedFrame(self.sequence.read(index), bitstream, self.codec.decode(bitstream))


def slam_ms(frames: int) -> tuple[float, float]:
    """CPU milliseconds a frame, mean and median, of our SLAM on the embedded sequence."""
    sequence = installed().create("dataset", "synthetic", {"stop": frames}).open()
    backend = installed().create("slam_backend", "orb", {})
    pictures = list(sequence)
    backend.run(pictures, sequence.camera, seed=0)  # compile
    begun = time.process_time()
    run = backend.run(pictures, sequence.camera, seed=0)
    mean = 1000 * (time.process_time() - begun) / frames
    return mean, float(np.median([frame.elapsed_ms for frame in run.frames]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--frames", type=int, default=120)
    chosen = parser.parse_args()
    print("| what | measured |\n|---|---:|")
    for name, seconds in starts(chosen.rounds).items():
        print(f"| `{name}` | {1000 * seconds:.0f} ms |", flush=True)
    for cache, (first, last) in first_runs(3).items():
        print(
            f"| `codecbench run examples/first.yaml`, {cache} cache: first result, end | {first:.1f} s, {last:.1f} s |"
        )
    mean, median = slam_ms(chosen.frames)
    print(f"| SLAM `orb`, 640x480, one thread: CPU time a frame, mean | {mean:.1f} ms |")
    print(f"| SLAM `orb`: wall time a frame, median | {median:.1f} ms |", flush=True)
    print(f"| quality cell / bare loop, frames a second | {engine_share(chosen.frames // 2, 3):.2f} |")


if __name__ == "__main__":
    main()

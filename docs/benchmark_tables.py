"""Tables of what pytest-benchmark wrote with --benchmark-json, and of what other commands printed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

from codecbench.core.report.tables import cell, table

Benchmarks = list[dict[str, Any]]
Heads = tuple[str, ...]
BUILDS = ("fast", "counting")


def codecs(found: Benchmarks, heads: Heads) -> Iterator[str]:
    """Medians of one frame, encoding and decoding."""
    ms = {
        (test_name(b), b["params"]["picture"], b["params"]["codec"]): median_ms(b)
        for b in of_file(found, "test_codecs")
    }
    settings = {
        b["params"]["codec"]: b["extra_info"]["setting"] for b in of_file(found, "test_codecs") if b["extra_info"]
    }
    rows = []
    for codec, setting in settings.items():
        both = [
            " / ".join(cell(round(ms[way, picture, codec], 2)) for way in ("test_encode", "test_decode"))
            for picture in ("gray", "rgb")
        ]
        rows.append([f"`{codec}`" + (f", {setting}" if setting else ""), *both])
    yield table(heads, rows)


def multilevel(found: Benchmarks, heads: Heads) -> Iterator[str]:
    """Medians of encoding and decoding together, one row a kind of picture, number of levels and effort."""
    times: dict[str, dict[int, float]] = {}
    for benchmark in of_file(found, "test_multilevel"):
        if test_name(benchmark) == "test_encode_and_decode":
            params = benchmark["params"]
            what = f"{params['picture']}, levels {params['levels']}"
            what += ", fast" if params.get("effort") == "fast" else ""
            times.setdefault(what, {})[params["qf"]] = median_ms(benchmark)
    rows = [[what, *(f"{row[qf]:.1f} ms" for qf in (5, 20, 100))] for what, row in sorted(times.items())]
    yield table(heads, rows)


def kernel_builds(found: Benchmarks, heads: Heads) -> Iterator[str]:
    """Every stage of an encoding and a decoding of a gray picture, added up, in both builds."""
    sums: dict[tuple[str, str], float] = {}
    for benchmark in of_file(found, "test_kernels"):
        if test_name(benchmark) == "test_stage":
            codec = next(part for part in re.split(r"[\[\]/-]", benchmark["name"])[1:] if part not in BUILDS)
            key = (codec, benchmark["params"]["build"])
            sums[key] = sums.get(key, 0.0) + median_ms(benchmark)
    rows = []
    for codec in dict.fromkeys(codec for codec, _ in sums):
        fast, counting = (sums[codec, build] for build in BUILDS)
        rows.append([f"`{codec}`", f"{fast:.1f} ms", f"{counting:.1f} ms", f"{counting / fast:.1f}"])
    yield table(heads, rows)


def contract(found: Benchmarks, heads: Heads) -> Iterator[str]:
    """What coding through the engine adds to bare calls of a codec, one row a way and kind of picture."""
    rows = []
    for benchmark in of_file(found, "test_contract"):
        told = benchmark["extra_info"]
        times = [f"{told[side]:.2f} ms" for side in ("bare_ms", "engine_ms")]
        rows.append([what(benchmark), *times, f"{told['overhead_percent']:+.1f} %"])
    yield table(heads, rows)


def medians(file: str) -> Callable[[Benchmarks, Heads], Iterator[str]]:
    """One row a benchmark of a file, called as its test is: of one unit, where it says of how many its time is."""

    def content(found: Benchmarks, heads: Heads) -> Iterator[str]:
        units = [b["extra_info"].get("units", 1) for b in of_file(found, file)]
        each_ms = [median_ms(b) / unit for b, unit in zip(of_file(found, file), units, strict=True)]
        rows = [
            [what(b), f"{cell(float(f'{ms:.3g}'))} ms"] for b, ms in zip(of_file(found, file), each_ms, strict=True)
        ]
        yield table(heads, rows)

    return content


def what(benchmark: dict[str, Any]) -> str:
    """`test_pose_graph[150]` in words: pose graph, 150."""
    parameter = f", {benchmark['param']}" if benchmark["param"] else ""
    return test_name(benchmark).removeprefix("test_").replace("_", " ") + parameter


def of_file(found: Benchmarks, file: str) -> Benchmarks:
    return [benchmark for benchmark in found if f"/{file}.py::" in f"/{benchmark['fullname']}"]


def test_name(benchmark: dict[str, Any]) -> str:
    return str(benchmark["name"]).partition("[")[0]


def median_ms(benchmark: dict[str, Any]) -> float:
    return 1e3 * float(benchmark["stats"]["median"])


def without_headings(text: str, heads: Heads) -> Iterator[str]:
    """The Markdown that a command printed, without its headings."""
    yield re.sub(r"^### .*\n\n", "", text, flags=re.MULTILINE).strip()


def printed(text: str, heads: Heads) -> Iterator[str]:
    """The rows of a table with as many columns that a command printed, among whatever else it said."""
    rows = [row for row in re.findall(r"\| .* \|$", text, re.MULTILINE) if row.count(" | ") == len(heads) - 1]
    head = "| " + " | ".join(heads) + " |"
    if not (rows := [row for row in rows if row != head]):
        raise SystemExit(f"nothing printed is a row of {len(heads)} columns: {head}")
    yield table(heads, []) + "\n".join(rows)

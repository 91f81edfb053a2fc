"""Contradictions in the paper, each with our measurements. Nothing here is tuned to agree."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from codecbench.core.analysis.ranking import rankings_on
from codecbench.core.report.formatting import less_rate
from codecbench.core.report.tables import escape
from codecbench.paper.measured import Measured, paper_table


def contradictions(runs: list[Measured]) -> Iterator[tuple[str, str, list[str]]]:
    """Yield for each claim its title, what the paper says and what its numbers imply, and our measurements.

    Trajectories are those of all runs, all else is of the first.
    """
    for title, statement, measure in _CLAIMS:
        measured_runs = runs if measure is _success else runs[:1]
        lines = dict.fromkeys(line for measured in measured_runs for line in measure(measured))
        yield title, statement, list(lines) or ["not measured in these runs"]


def _dct(measured: Measured) -> list[str]:
    lines = []
    for sequence in measured.sequences[:1]:
        for codec in ("jpeg_qf", "multilevel"):
            setting = measured.setting(codec, qf=5)
            mults, adds = (
                measured.value(sequence, setting, f"operations.source_{name}.encode/dct.mean")
                for name in ("mults", "adds")
            )
            if not np.isnan(mults):
                lines.append(f"{codec} counts {mults:,.0f} multiplications and {adds:,.0f} additions in its DCT")
    return lines


def _slightly(measured: Measured) -> list[str]:
    sequence = measured.sequences[0]
    totals = {
        (codec, way): measured.value(sequence, measured.setting(codec, qf=5), f"operations.source_total.{way}.mean")
        for codec in ("jpeg_qf", "multilevel")
        for way in ("encode", "decode")
    }
    if any(np.isnan(value) for value in totals.values()):
        return []
    ratios = [totals["multilevel", way] / totals["jpeg_qf", way] for way in ("encode", "decode")]
    origin = f"Counted in the kernels at QF 5 on {escape(sequence)}"
    return [f"{origin}: multi-level / JPEG is {ratios[0]:.2f} encoding, {ratios[1]:.2f} decoding"]


def _search(measured: Measured) -> list[str]:
    lines = []
    for sequence in measured.sequences[:1]:
        for qf in (5.0, 100.0):
            for search in ("sequential", "pruned", "greedy"):
                setting = measured.setting("multilevel", qf=qf, decoding="search", search=search)
                tests = measured.value(sequence, setting, f"operations.source_comparisons.decode/{search}_search.mean")
                if not np.isnan(tests):
                    lines.append(f"QF {qf:g} {search}: {tests:,.0f} comparisons a frame")
    return lines


def _header(measured: Measured) -> list[str]:
    lines = []
    for qf in (5.0, 20.0, 100.0):
        with_header = measured.setting("multilevel", qf=qf, levels=1, decoding="header")
        without = measured.setting("multilevel", qf=qf, levels=1, decoding="search")
        for sequence in measured.sequences:
            sizes = [measured.size_kib(sequence, setting) for setting in (with_header, without)]
            if not np.isnan(sizes).any():
                lines.append(
                    f"QF {qf:g} on {escape(sequence)}: {sizes[0]:.1f} KiB with the table of tuples, "
                    f"{sizes[1]:.1f} KiB without"
                )
    return lines


def _levels(measured: Measured) -> list[str]:
    lines = []
    for qf in (5.0, 20.0, 100.0):
        single, double = (measured.setting("multilevel", qf=qf, levels=levels, decoding="header") for levels in (1, 2))
        for sequence in measured.sequences:
            sizes = [measured.size_kib(sequence, setting) for setting in (single, double)]
            if not np.isnan(sizes).any():
                change = 100 * (sizes[1] / sizes[0] - 1)
                lines.append(f"QF {qf:g} on {escape(sequence)}: two levels change the size by {change:+.1f} %")
    return lines


def _ssim(measured: Measured) -> list[str]:
    lines = []
    for sequence in measured.sequences:
        for qf in (5.0, 10.0, 15.0, 20.0):
            ours = [
                measured.value(sequence, measured.setting(codec, qf=qf), "quality.ssim_matlab.mean")
                for codec in ("jpeg_qf", "multilevel")
            ]
            if not np.isnan(ours).any():
                lines.append(f"QF {qf:g} on {escape(sequence)}: JPEG {ours[0]:.4f}, multi-level {ours[1]:.4f}")
    return lines


def _success(measured: Measured) -> list[str]:
    lines = []
    raw = measured.setting("raw")
    for sequence in measured.sequences:
        for qf in (75.0, 100.0):
            setting = measured.setting("multilevel", qf=qf)
            for column in measured.run.wide.columns:
                evaluator, _, rest = str(column).partition(".")
                value = measured.value(sequence, setting, str(column)) if rest == "success.mean" else np.nan
                # If raw frames fail too, as on a handful of frames, the codec is not the cause.
                if np.isnan(value) or measured.value(sequence, raw, str(column)) == 0.0:
                    continue
                loops = measured.value(sequence, setting, f"{evaluator}.loops_closed.median")
                where = f"{escape(sequence)}{evaluator.removeprefix('trajectory')}"
                lines.append(
                    f"{where}: {100 * value:.0f} % of runs at QF {qf:g} succeed, loops closed {loops:.0f} (median)"
                )
    return lines


def _rounding(measured: Measured) -> list[str]:
    """Recompute compression ratios from the paper's own sizes."""
    errors = []
    for name, label in (("table1_jpeg", "Table 1"), ("table2_jpeg2000", "Table 2"), ("table3_multilevel", "Table 3")):
        for row in paper_table(name).to_dict("records"):
            for prefix in ("l1_", "l2_") if name.startswith("table3") else ("",):
                stated = float(row[f"{prefix}cr_percent"])
                implied = 100 * (1 - row[f"{prefix}size_kb"] / row["original_kb"])
                if abs(implied - stated) > 0.5 + 1e-9:
                    which = row.get("qf", row.get("cr_percent"))
                    errors.append(
                        f"{label} frame {row['frame']:.0f} at {which:g}: {stated:g} % stated, {implied:.1f} % implied"
                    )
    return errors


def _real_jpeg(measured: Measured) -> list[str]:
    column = measured.run.columns.get("quality.psnr_gray_db.mean")
    if column is None:
        return []
    return [
        f"PSNR of gray, {escape(ranked.curve)} on {escape(ranking.sequence)}: {less_rate(evidence, escape(anchor))}"
        for ranking in rankings_on(measured.run, column, [[sequence] for sequence in measured.sequences])
        for anchor in ranking.anchors
        for ranked in ranking.ranked
        if ranked.curve.startswith("multilevel") and (evidence := ranking.evidence(ranked.curve, anchor))
    ]


_CLAIMS: Final[tuple[tuple[str, str, Callable[[Measured], list[str]]], ...]] = (
    (
        "The same DCT has two costs",
        "Table 4 charges 112 additions a block, Table 6 charges 56. 64 multiplications and 56 additions a "
        "block are one 8-point product; a separable 8x8 transform takes 1024 and 896, or 80 and 464 in the "
        "form of Arai, Agui and Nakajima.",
        _dct,
    ),
    (
        "“Slightly less complex”",
        "By the paper's own totals JPEG takes 5.08 M operations against 6.11 M encoding and 4.50 M against "
        "11.27 M decoding.",
        _slightly,
    ),
    (
        "Five tests a coefficient cannot be a search",
        "Table 6 charges five comparisons a coefficient to the sequential search; a search over all tuples "
        "needs orders of magnitude more at low QF.",
        _search,
    ),
    (
        "Dropping the header saves nothing",
        "The table of distinct codes carries the same information as the table of tuples. The conclusion "
        "calls header-less coding future work; section 3.2 says that it was used.",
        _header,
    ),
    (
        "Two levels do not beat one by up to 37 %",
        "Table 3 gives two levels 1 to 37 % less than one. With the tables counted the gain is small or negative.",
        _levels,
    ),
    (
        "“96 % succeeds”",
        "96 % is QF 100, which the text says fails to close the loop; the best success is QF 75 (95 and 94 %).",
        _success,
    ),
    (
        "“Better than JPEG in SSIM at all QF”",
        "At frame 1132, QF 5, Table 3 has 0.9515 and Table 1 has 0.9579.",
        _ssim,
    ),
    (
        "Compression ratios that do not follow from the sizes",
        "CR is 1 - size / PNG size. Besides, frame 2398 at QF 50 (32.2985 dB) breaks its own curve; 31.2985 would fit.",
        _rounding,
    ),
    (
        "JPEG as it is practiced",
        "The paper's JPEG column is not what libjpeg produces at equal quality.",
        _real_jpeg,
    ),
)

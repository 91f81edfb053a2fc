"""Tables of a run: what its wide table says, in the columns that readers ask for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from codecbench.core.analysis.ranking import rankings_on
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.formatting import signed_percent
from codecbench.core.report.tables import cell, table

Heads = tuple[str, ...]
Row = dict[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of the wide table as readers see it, in another unit where `factor` says so."""

    name: str
    factor: float = 1.0

    def shown(self, row: Row | None) -> str:
        value = float("nan") if row is None else float(row.get(self.name, np.nan)) * self.factor
        return cell(round(value, 3) if np.isfinite(value) else value)


CODING = {
    "bit/px": Column("quality.rate_bpp.mean"),
    "CR vs PNG %": Column("quality.cr_percent.mean"),
    "PSNR dB": Column("quality.psnr_gray_db.mean"),
    "SSIM": Column("quality.ssim_matlab.mean"),
    "features kept": Column("features.keypoint_repeatability.mean"),
    "search ms": Column("timing.prepare_cpu_ms.median"),
    "encode ms": Column("timing.encode_cpu_ms.median"),
    "decode ms": Column("timing.decode_cpu_ms.median"),
    "counted Mops": Column("operations.source_total.encode.mean", 1e-6),
    "paper's model Mops": Column("operations.model_total.encode.mean", 1e-6),
}
SETTING = ("codec", "setting")
MAIN, STILLS = "fr3_office_100", "kodak"
"""The sequences of examples/real.yaml that are set beside each other: a video, and photographs."""


def beside_photographs(run: RunResult, heads: Heads) -> Iterator[str]:
    """The office beside photographs, with what the table says about itself."""
    frames = {entry.name: entry.frames for entry in run.plan.sequences}
    yield (
        f"`codecbench run examples/real.yaml`, here {frames[MAIN]} frames of TUM's freiburg3_long_office_household "
        "(640x480 RGB; Sturm et al.\n2012, CC BY 4.0) beside "
        f"{frames[STILLS]} photographs of Kodak's, processor time on one core of a shared\n{machine(run)}; "
        "all of it below:\n"
    )
    stills = {(row["codec"], row["setting"]): row for row in rows_of(run, STILLS)}
    lines = []
    for row in rows_of(run, MAIN):
        still = stills.get((row["codec"], row["setting"]))
        own = [CODING[head].shown(row) for head in heads if head in CODING]
        beside = [CODING[head].shown(still) for head in ("bit/px", "features kept")]
        lines.append([row["codec"], row["setting"], *own, *beside])
    yield table(heads, lines)
    yield (
        "“Features kept” is the share of the original frame's ORB keypoints that are found again in the decoded frame, "
        "which is what a\ntracker relies on. A dash in “counted” means an opaque library: its operations are unknown, "
        f"not zero. {against_psnr(run)}\n"
    )
    yield "![Rate against features kept, one line a codec](images/rate_features.svg)"


def against_psnr(run: RunResult) -> str:
    """How far PSNR says the same as features kept: the order on one sequence, and the level across sequences."""
    qualities, features = zip(*quality_and_features(rows_of(run, MAIN)), strict=True)
    from scipy.stats import spearmanr  # a second of import, for this sentence alone

    rho = spearmanr(qualities, features).statistic
    sentence = f"On one sequence PSNR\nranks the settings almost alike (Spearman's ρ {rho:.3f})"
    kept = [at_quality([row for row in rows_of(run, name) if row["codec"] == "jpeg"], 30.0) for name in (MAIN, STILLS)]
    if any(map(np.isnan, kept)):
        return f"{sentence}."
    return (
        f"{sentence}; across images it does not predict how many survive: JPEG at 30 dB keeps\n"
        f"{100 * kept[0]:.0f} % in the office and {100 * kept[1]:.0f} % on the photographs."
    )


def quality_and_features(rows: list[Row]) -> list[tuple[float, float]]:
    """PSNR and features kept of the lossy settings, in order of PSNR."""
    pairs = [tuple(float(row[CODING[head].name]) for head in ("PSNR dB", "features kept")) for row in rows]
    return sorted((psnr, kept) for psnr, kept in pairs if np.isfinite(psnr))


def at_quality(rows: list[Row], psnr_db: float) -> float:
    """Features kept at a PSNR, interpolated between settings; NaN outside them."""
    qualities, kept = zip(*quality_and_features(rows), strict=True)
    return float(np.interp(psnr_db, qualities, kept, left=np.nan, right=np.nan))


def every_sequence(run: RunResult, heads: Heads) -> Iterator[str]:
    """A section a sequence, and what was not computed."""
    yield f"Times are processor time a frame, medians, on one core of a shared {machine(run)}.\n"
    for entry in run.plan.sequences:
        yield f"### {entry.name}\n"
        yield f"{entry.frames} frames.\n"
        yield coding_table(run, entry.name, heads)
    reasons = sorted({f"{r.cell.evaluator.name} of {r.cell.codec.name} ({r.reason})" for r in run.results if r.reason})
    done = sum(result.status == "ok" for result in run.results)
    yield f"{done} of {len(run.plan.cells)} cells" + (f"; not computed: {'; '.join(reasons)}." if reasons else ".")


def first_sequence(run: RunResult, heads: Heads) -> Iterator[str]:
    """What the first run prints at its end, with the machine that it ran on."""
    yield f"Processor time on one core of a shared {machine(run)}:\n"
    yield coding_table(run, run.plan.sequences[0].name, heads)


def coding_table(run: RunResult, sequence: str, heads: Heads) -> str:
    rows = rows_of(run, sequence)
    return table(heads, [[row[head] if head in SETTING else CODING[head].shown(row) for head in heads] for row in rows])


def rates_beside_anchor(run: RunResult, heads: Heads) -> Iterator[str]:
    """How much more rate each curve takes than the anchor for the same quality, sequence by sequence."""
    sequences = [[entry.name] for entry in run.plan.sequences]
    shown: dict[tuple[str, str], dict[str, str]] = {}
    for head in heads[2:]:
        name = next(column.name for known, column in CODING.items() if known.startswith(head))
        for ranking in rankings_on(run, run.columns[name], sequences):
            for anchor, ranked in product(ranking.anchors[:1], ranking.ranked):
                if found := ranking.evidence(ranked.curve, anchor):
                    shown.setdefault((ranking.sequence, ranked.curve), {})[head] = signed_percent(found)
    yield table(heads, [[*key, *(shown[key].get(head, "–") for head in heads[2:])] for key in sorted(shown)])


def rows_of(run: RunResult, sequence: str) -> list[Row]:
    wide = run.wide
    return [{str(k): v for k, v in row.items()} for row in wide[wide["sequence"] == sequence].to_dict("records")]


def machine(run: RunResult) -> str:
    names = {str(environment.get("machine", {}).get("cpu")) for environment in run.environments.values()}
    return ", ".join(sorted(names)) or "machine that is not known"

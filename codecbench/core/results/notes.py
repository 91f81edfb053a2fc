"""What is to be known of sequences, metrics and codec settings beside their numbers, for people."""

from __future__ import annotations

from collections import defaultdict

from codecbench.core.results.run_result import RunResult


def notes(run: RunResult) -> list[str]:
    """A sentence for each note on a sequence, for each caveat of a headline, and for those on codec settings."""
    sequences = [f"{entry.name}: {note}." for entry in run.plan.sequences for note in entry.notes]
    caveats = [f"{column.label}: {column.metric.caveat}." for column in run.headlines() if column.metric.caveat]
    return [*sequences, *dict.fromkeys(caveats), *setting_notes(run)]


def setting_notes(run: RunResult) -> list[str]:
    """A sentence for each note of a curve, with the settings of it that have the note where not all have."""
    points: dict[str, set[str]] = defaultdict(set)
    noted: dict[tuple[str, str], dict[str, None]] = defaultdict(dict)
    for result in run.results:
        place = run.curves[result.cell.codec.name, result.cell.codec.label]
        points[place.curve].add(place.point)
        for note in result.notes:
            noted[place.curve, note][place.point] = None
    return [
        f"{curve}: {note}." if found.keys() == points[curve] else f"{curve}, {', '.join(found)}: {note}."
        for (curve, note), found in noted.items()
    ]

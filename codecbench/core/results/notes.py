"""What is to be known of sequences, metrics and codec settings beside their numbers, for people."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection

from codecbench.core.results.run_result import RunResult


def notes(run: RunResult) -> list[str]:
    """A sentence for each note on a sequence, for each caveat of a headline, and for those on codec settings."""
    return [*sequence_notes(run), *caveats(run), *setting_notes(run)]


def sequence_notes(run: RunResult) -> list[str]:
    """A sentence for each note, with the sequences that have it: what was done to frames, how many of them are used."""
    noted: dict[str, list[str]] = defaultdict(list)
    for entry in run.plan.sequences:
        for note in entry.notes:
            noted[note].append(entry.name)
    return [f"{', '.join(names)}: {note}." for note, names in noted.items()]


def caveats(run: RunResult, evaluators: Collection[str] | None = None) -> list[str]:
    """A sentence for each caveat of a headline, of all evaluators or of those with these names or titles."""
    columns = [
        column
        for column in run.headlines()
        if evaluators is None or column.evaluator.name in evaluators or column.evaluator.title in evaluators
    ]
    return list(dict.fromkeys(f"{column.label}: {column.metric.caveat}." for column in columns if column.metric.caveat))


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

"""What a column of the wide table is: the one place from which screens, pages, figures and files take their heads."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import PluginSetting

if TYPE_CHECKING:
    from codecbench.core.analysis.table import CellResult


@dataclass(frozen=True)
class Column:
    """An aggregate of a metric of an evaluator's setting, of one stage or of none ("")."""

    evaluator: PluginSetting
    metric: Metric
    stage: str
    aggregate: str

    @property
    def name(self) -> str:
        """As in the wide table: `evaluator.metric[.stage].aggregate`."""
        return f"{self.evaluator.title}.{self.measure}.{self.aggregate}"

    @property
    def measure(self) -> str:
        """The metric with its stage: `metric[.stage]`."""
        return f"{self.metric.name}.{self.stage}" if self.stage else self.metric.name

    @property
    def label(self) -> str:
        """For people: what is measured, of which stage, under which setting, and how summarised where not as usual."""
        words = f"{self.stage} {self.metric.label}" if self.stage else self.metric.label
        setting = f" ({self.evaluator.label})" if self.evaluator.label else ""
        return words + setting + ("" if self.is_usual else f", {self.aggregate}")

    @property
    def heading(self) -> str:
        """The label with the unit that people are shown."""
        return f"{self.label} [{self.unit}]" if self.unit not in ("", "1") else self.label

    @property
    def short_heading(self) -> str:
        """A narrow head, on several lines where there is more to say than the metric."""
        return "\n".join(filter(None, (self.stage, self.metric.column_header, self.evaluator.label)))

    @property
    def unit(self) -> str:
        """The unit that people are shown; none for a count of values."""
        return "" if self.aggregate == "infinite" else self.metric.display_unit

    @property
    def factor(self) -> float:
        """What a value of the table is multiplied by to be in `unit`."""
        return 1.0 if self.aggregate == "infinite" else self.metric.display_factor

    @property
    def better(self) -> str:
        """In which direction what people are shown is better: the other one where the factor turns the sign."""
        turned = {"lower": "higher", "higher": "lower"} if self.factor < 0 else {}
        return turned.get(self.metric.better, self.metric.better)

    @property
    def is_usual(self) -> bool:
        """Whether this is the summary that stands for the metric: its first aggregate."""
        return self.aggregate == self.metric.aggregates[0]

    @property
    def is_headline(self) -> bool:
        """Whether it is shown first: the usual summary of a headline, in total and not of a part (`encode/dct`)."""
        return self.metric.headline and self.is_usual and "/" not in self.stage


def columns_of(results: Iterable[CellResult]) -> dict[str, Column]:
    """Every column that the wide table of these results can have, by name.

    Columns stand in the order of evaluators, then in that in which each declares its metrics.
    """
    found: dict[tuple[PluginSetting, str], dict[tuple[str, str, str], Column]] = {}
    declared: dict[PluginSetting, dict[str, Metric]] = {}
    for result in results:
        setting = result.cell.evaluator
        metrics = declared.setdefault(setting, {})
        metrics.update(result.metrics)
        keys = [*result.summaries, *_single(result)]
        for name, stage, how in keys:
            metric = metrics.get(name) or Metric(name, "", "neither", "")
            found.setdefault((setting, name), {}).setdefault((name, stage, how), Column(setting, metric, stage, how))
    ordered: dict[str, Column] = {}
    for setting, metrics in declared.items():
        undeclared = [name for owner, name in found if owner == setting and name not in metrics]
        for name in (*metrics, *undeclared):
            ordered |= {column.name: column for column in found.get((setting, name), {}).values()}
    return ordered


def _single(result: CellResult) -> Iterable[tuple[str, str, str]]:
    """Keys of what was measured once a repeat."""
    for measured in result.measurements:
        metric = result.metrics.get(measured.metric)
        for how in metric.aggregates if metric else ("mean",):
            yield measured.metric, measured.stage or "", how

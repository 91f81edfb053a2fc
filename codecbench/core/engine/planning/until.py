"""`run: {until: {decided: ...}}`: what is to be decided by adding repeats where they decide something."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, Field, field_validator

from codecbench.core.engine.planning.objective import Objective, find_objective
from codecbench.core.engine.planning.search_section import ObjectiveSection
from codecbench.core.engine.planning.yaml_file import Problems, plain

if TYPE_CHECKING:
    from codecbench.core.engine.planning.entry import Entry


class UntilSection(BaseModel):
    """`decided`: the name of a metric of role `success`, or a metric with `min` or `max`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    decided: ObjectiveSection = Field(
        description="a metric of role success by its name, or {metric: NAME, min: NUMBER}"
    )

    @field_validator("decided", mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:
        return {"metric": value, "min": 1} if isinstance(value, str) else value

    @field_validator("decided")
    @classmethod
    def _bounded(cls, value: ObjectiveSection) -> ObjectiveSection:
        if value.equal is not None:
            raise ValueError("takes min or max: a repeat meets it or does not")
        return value


def decided_objective(
    section: UntilSection | None, root: Any, evaluators: Sequence[Entry], problems: Problems
) -> Objective | None:
    """What is to be decided; None where nothing is, or, with a problem, where it cannot be."""
    if section is None:
        return None
    where = ("run", "until", "decided")
    objective = find_objective(section.decided, evaluators, where, problems)
    if objective is None:
        return None
    if isinstance(plain(root["run"]["until"]["decided"]), str) and objective.metric.role != "success":
        message = f"{objective.metric.name} is no success or failure; give it a limit: {{metric: NAME, max: NUMBER}}"
        problems.add(where, message)
        return None
    if repeats_of(objective.evaluator.title, evaluators) < 2:
        problems.add(
            where, f"evaluator {objective.evaluator.title} has a single repeat; give it as many as may be spent"
        )
        return None
    return objective


def repeats_of(title: str, evaluators: Sequence[Entry]) -> int:
    """How many repeats an evaluator's setting has; 1 where it cannot be used here."""
    for entry in evaluators:
        if entry.setting.title == title and entry.description is not None:
            return max(1, len(entry.description.identities))
    return 1

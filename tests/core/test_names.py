"""No codec, evaluator, metric, dataset, backend or executor of ours stands in core as text."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import get_args

import pytest

import codecbench
from codecbench.core.conformance.harness import Shape
from codecbench.core.contracts.codec import Architecture
from codecbench.core.contracts.hooks import KINDS
from codecbench.core.contracts.metric import Role
from codecbench.core.engine.hosting.channel import FACTS, METHODS
from codecbench.core.engine.plugins.registry import Registry

CORE = Path(codecbench.__file__).parent / "core"
OURS = Registry(point for point in entry_points(group="codecbench") if point.dist and point.dist.name == "codecbench")
NAMES = {plugin.spec.name for kind in KINDS for plugin in OURS.plugins(kind)}
METRICS = {
    metric.name
    for plugin in OURS.plugins("evaluator")
    if plugin.missing is None
    for metric in OURS.load("evaluator", plugin.spec.name).metrics
}
VOCABULARY = {word for words in (Role, Shape, Architecture) for word in get_args(words)}
VOCABULARY |= {method for methods in METHODS.values() for method in methods} | {"trace"}
VOCABULARY |= {fact for facts in FACTS.values() for fact in facts} | {"zstd"}
"""Roles of metrics, shapes of codecs, architectures, and methods, attributes and keywords of contracts are words of
core, and so is the compression of Parquet files; that a plugin or a metric is called like one of them is no
dependence."""


def quoted_in_python(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of every string that is not documentation, parts of formatted ones included."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value.value = None
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def quoted_in_page(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of everything in quotes of a script, a style or a template."""
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        for groups in re.findall(r'"([^"]*)"|\'([^\']*)\'|`([^`]*)`', line):
            yield number, next(filter(None, groups), "")


def named(text: str) -> list[str]:
    """Names of ours that a quoted text is, begins with as a column does, or holds as a metric."""
    whole = (NAMES | METRICS) - VOCABULARY
    columns = [name for name in NAMES if re.match(rf"{name}(\(.*\))?\.\w", text)]
    compound = {metric for metric in METRICS - VOCABULARY if "_" in metric}
    return [*columns, *({text} & whole), *(set(re.findall(r"\w+", text)) & compound)]


PARTS = sorted(path for path in CORE.rglob("*") if path.suffix in (".py", ".js", ".j2", ".css"))


def test_the_names_are_read() -> None:
    assert {"raw", "jpeg", "trajectory", "synthetic", "orb", "local"} <= NAMES
    assert {"psnr_gray_db", "ate_rmse_m", "encode_wall_ms", "source_total", "keypoint_repeatability"} <= METRICS
    assert len(PARTS) > 50
    assert named("quality.psnr_gray_db.mean")
    assert named("trajectory(architecture=cta).maps")
    assert not named("what the raw codec left")


@pytest.mark.parametrize("path", PARTS, ids=lambda path: str(path.relative_to(CORE)))
def test_core_names_nothing_of_ours(path: Path) -> None:
    quoted = quoted_in_python(path) if path.suffix == ".py" else quoted_in_page(path)
    assert [f"{path.name}:{line}: {text!r}" for line, text in quoted if named(text)] == []

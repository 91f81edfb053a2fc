"""What docs/pictures-or-features.md shows works, and its table is of the settings that its command runs."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest
from project import DOCS, EXAMPLES

from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import installed
from codecbench.plugins.codecs.orb_features.codec import OrbFeaturesParams

PAGE = (DOCS / "pictures-or-features.md").read_text()


@pytest.mark.thorough
def test_the_lines_of_python_run(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"<!-- features: python -->\n```python\n(.*?)```", PAGE, re.DOTALL)
    exec(code, {})
    first, *others = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"\d+ features alone", first)
    assert len(others) == 2
    assert all(re.fullmatch(r"\d+ features after the set before", line) for line in others)


def test_every_parameter_is_explained_with_its_default() -> None:
    for name, value in OrbFeaturesParams().model_dump().items():
        shown = f"`{value}`" if isinstance(value, str) else str(value)
        assert re.search(rf"^\| `{name}` \| [^|]+ \| {shown} \|", PAGE, re.MULTILINE), name


def test_the_reference_table_plans_features_beside_pictures_under_every_evaluator(tmp_path: Path) -> None:
    """With the embedded sequence in the place of those of the example, which need not be here."""
    text = (EXAMPLES / "reference.yaml").read_text()
    small = "sequences:\n  - {use: synthetic, params: {stop: 12, width: 64, height: 48}}\n"
    text = re.sub(r"sequences:\n(?:  - .*\n)+", small, text)
    (tmp_path / "matrix.yaml").write_text(text)
    plan = make_plan(read_matrix(tmp_path / "matrix.yaml"), installed())
    shares = Counter((cell.codec.name, cell.evaluator.name) for cell in plan.cells)
    for evaluator, count in (("quality", 1), ("localization", 1), ("trajectory", 2), ("timing", 1)):
        assert shares["orb_features", evaluator] == shares["jpeg", evaluator] == 8 * count

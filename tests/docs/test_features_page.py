"""What docs/pictures-or-features.md shows works, and its table is of the settings that its command runs."""

from __future__ import annotations

import re
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from project import DOCS, EXAMPLES

from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.registry import installed
from codecbench.plugins.codecs.orb_features.codec import OrbFeatures, OrbFeaturesParams
from codecbench.plugins.codecs.raw import Raw

sys.path.insert(0, str(DOCS))
import feature_tables

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


def test_the_table_shows_the_settings_that_are_run() -> None:
    names = [feature_tables.title(name, params) for name, params in feature_tables.PICTURES]
    names += [feature_tables.title("orb_features", params) for params in feature_tables.FEATURES]
    table = PAGE.partition("features-by-rate: begin")[2].partition("features-by-rate: end")[0]
    assert re.findall(r"^\| (`.+?) \| ", table, re.MULTILINE) == names


def test_what_is_sent_is_counted_and_received() -> None:
    rng = np.random.default_rng(2)
    frames = [np.kron(rng.integers(0, 256, (20, 25)), np.ones((6, 6))).astype(np.uint8) for _ in range(2)]
    sent = feature_tables.features(OrbFeatures.create(features=100), "few", frames)
    assert sent.features == 100
    assert len(sent.received) == len(sent.sizes) == len(sent.counts) == 2
    assert all(len(taken) == 2 for taken in sent.steps_ms.values())


def test_pictures_are_sent_one_by_one_and_received() -> None:
    frames = [np.full((48, 64), 10 * k, np.uint8) for k in range(3)]
    sent = feature_tables.pictures(Raw.create(), "raw", frames)
    assert all(np.array_equal(back, frame) for back, frame in zip(sent.received, frames, strict=True))
    assert len(sent.sizes) == 3


def test_the_example_plans_every_codec_under_every_evaluator(tmp_path: Path) -> None:
    """With the embedded sequence in the place of the office, which need not be here."""
    text = (EXAMPLES / "features.yaml").read_text()
    text = re.sub(r"  - \{use: tum.*", "  - {use: synthetic, params: {stop: 12, width: 64, height: 48}}", text)
    (tmp_path / "matrix.yaml").write_text(text)
    plan = make_plan(read_matrix(tmp_path / "matrix.yaml"), installed())
    shares = Counter((cell.codec.name, cell.evaluator.name) for cell in plan.cells)
    for evaluator, count in (("quality", 1), ("localization", 1), ("trajectory", 2), ("timing", 2)):
        assert shares["orb_features", evaluator] == 5 * count
        assert shares["jpeg", evaluator] == shares["multilevel", evaluator] == 4 * count

"""The matrix that is run to choose a setting over a link."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from codecbench.core.analysis.choosing import Demand
from codecbench.core.contracts.errors import MatrixError, PluginError
from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.plugins.registry import installed
from codecbench.trial.choosing import LinkMatrix, is_matrix, link_matrix

BOTH = Demand("wifi_edge", deadline_ms=100, error_m=0.05)


def made(folder: Path, demand: Demand, evaluators: str, more: str = "") -> LinkMatrix:
    path = folder / "mine.yaml"
    path.write_text(
        "version: 1\nsequences: [synthetic]  # a room\ncodecs:\n  - {use: jpeg, params: {quality: {grid: [10, 40]}}}\n"
        f"evaluators:\n{evaluators}{more}"
    )
    return link_matrix(path, demand, installed())


def evaluators(found: LinkMatrix) -> list[tuple[str, dict[str, Any]]]:
    return [
        (entry.setting.name, {name: entry.setting.params[name] for name in entry.description.explicit})
        for entry in found.matrix.evaluators
        if entry.description is not None
    ]


def test_what_is_lacking_is_added_and_the_rest_stays(tmp_path: Path) -> None:
    found = made(tmp_path, BOTH, "  - quality\n", "run: {workers: 1}\n")
    assert evaluators(found) == [
        ("quality", {}),
        ("delivery", {"link": "wifi_edge", "repeats": 20}),
        ("trajectory", {"link": "wifi_edge", "start_offsets": list(range(16))}),
    ]
    assert found.matrix.name == "mine"
    assert found.matrix.run.workers == 1
    assert "# a room" in found.matrix.text
    assert str(found.matrix.until) == "live_position_error_m ≤ 0.05"
    assert found.demand == BOTH
    assert len(found.added) == 3
    kept = tmp_path / "kept.yaml"
    kept.write_text(found.matrix.text)
    assert read_matrix(kept).evaluators == found.matrix.evaluators
    assert link_matrix(kept, BOTH, installed()).added == (), "nothing is lacking any more"


def test_what_is_added_goes_the_way_that_is_there(tmp_path: Path) -> None:
    own = "  - stream\n  - {use: trajectory, params: {link: wifi_edge, transport: arq, start_offsets: [0, 1]}}\n"
    found = made(tmp_path, BOTH, own)
    assert evaluators(found)[2] == ("delivery", {"link": "wifi_edge", "transport": "arq", "repeats": 20})
    assert len(found.added) == 1
    assert found.matrix.until is None, "two repeats decide nothing"


def test_another_link_does_not_count_and_only_what_is_asked_is_added(tmp_path: Path) -> None:
    own = "  - quality\n  - {use: delivery, params: {link: lte}}\n"
    found = made(tmp_path, Demand("wifi_edge", deadline_ms=100), own)
    assert [name for name, _ in evaluators(found)] == ["quality", "delivery", "delivery"]
    assert found.matrix.until is None


def test_a_rate_is_added_where_there_is_none(tmp_path: Path) -> None:
    found = made(tmp_path, Demand("ideal", deadline_ms=100), "  - timing\n")
    assert [name for name, _ in evaluators(found)] == ["timing", "stream", "delivery"]


def test_a_device_is_simulated_where_nothing_is_there_yet(tmp_path: Path) -> None:
    asked = Demand("lte", deadline_ms=100, device_factor=4.0)
    found = made(tmp_path, asked, "  - quality\n")
    way = {"link": "lte", "encode_ms": "measured", "device_factor": 4.0}
    assert evaluators(found) == [("quality", {}), ("timing", {}), ("delivery", {**way, "repeats": 20})]
    assert found.demand.device_factor is None
    there = made(tmp_path, asked, "  - quality\n  - {use: delivery, params: {link: lte}}\n")
    assert [name for name, _ in evaluators(there)] == ["quality", "delivery", "timing"]
    assert there.demand.device_factor == 4.0
    with pytest.raises(MatrixError, match=r"over lte .*\(encode_ms\)"):
        made(tmp_path, asked, "  - {use: delivery, params: {link: lte, encode_ms: 5}}\n")


def test_the_own_until_stays(tmp_path: Path) -> None:
    own = "  - quality\n  - timing\n  - {use: trajectory, params: {start_offsets: [0, 1, 2, 3]}}\n"
    found = made(tmp_path, BOTH, own, "run: {until: {decided: {metric: encode_cpu_ms, max: 5}}}\n")
    assert found.matrix.until is not None
    assert found.matrix.until.metric.name == "encode_cpu_ms"
    with pytest.raises(MatrixError, match=r"delivery, trajectory .* wifi_edge"):
        made(tmp_path, BOTH, own, "run: {until: {decided: {metric: trajectory.ate_rmse_m, max: 1}}}\n")


def test_a_link_that_is_not_known_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="'wifi_egde'"):
        made(tmp_path, Demand("wifi_egde", deadline_ms=100), "  - quality\n")


def test_a_dict_is_a_matrix_too() -> None:
    content = {"version": 1, "sequences": ["synthetic"], "codecs": ["jpeg"], "evaluators": ["quality"]}
    assert is_matrix(content)
    (added,) = link_matrix(content, Demand("ideal", deadline_ms=9), installed()).added
    assert {"delivery", "ideal"} <= set(added.split())
    assert not is_matrix("runs/link")

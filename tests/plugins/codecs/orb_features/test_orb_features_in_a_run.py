"""Features in a matrix beside pictures: by what they are measured, and that nothing is lost which SLAM reads."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import codecbench

SEQUENCE = {"use": "synthetic", "params": {"stop": 45, "width": 320, "height": 240}}
LOSSY = {"mode": "inter", "descriptor": "lossy", "angle_bits": 8}
CODECS = [
    "raw",
    {"use": "jpeg", "params": {"quality": 30}},
    "orb_features",
    {"use": "orb_features", "params": {"mode": "inter", "gop": 7}},
    {"use": "orb_features", "params": LOSSY},
]


def matrix(*evaluators: Any, codecs: list[Any] = CODECS) -> dict[str, Any]:
    """A matrix of the sequence."""
    named = {"version": 1, "name": "sent", "sequences": [SEQUENCE]}
    return {**named, "codecs": codecs, "evaluators": list(evaluators), "run": {"workers": 1}}


def values(run: codecbench.RunResult, metric: str) -> dict[tuple[str, str], float]:
    """Of every codec setting, the median over frames and repeats."""
    rows = run.tidy[run.tidy.metric == metric]
    return rows.groupby(["codec", "setting"], observed=True).value.median().to_dict()


@pytest.mark.thorough
def test_the_path_on_lossless_features_is_that_on_raw_pictures_to_the_bit(tmp_path: Path) -> None:
    """And one matrix holds codecs of both kinds, with a rate of each."""
    run = codecbench.run(matrix("quality", "trajectory", "features", "operations"), out=tmp_path / "run")
    paths = {}
    for result in run.results:
        if result.cell.evaluator.name == "trajectory":
            assert result.status == "ok", result.reason
            paths[result.cell.codec.name, result.cell.codec.label] = (
                (result.folder / "trajectory.txt").read_bytes(),
                (result.folder / "map_points.ply").read_bytes(),
            )
    assert len(paths["raw", ""][0].splitlines()) > 20
    same = {label for (name, label), path in paths.items() if name == "orb_features" and path == paths["raw", ""]}
    assert len(same) == 2
    assert not any("lossy" in label for label in same)
    rates = values(run, "rate_bpp")
    assert len(rates) == len(CODECS)
    assert all(rate > 0.0 for rate in rates.values())
    for (name, _), psnr in values(run, "psnr_gray_db").items():
        assert math.isnan(psnr) == (name == "orb_features")
    for result in run.results:
        of_pictures = result.cell.evaluator.name in ("features", "operations")
        if of_pictures and result.cell.codec.name == "orb_features":
            assert result.status == "unsupported"


@pytest.mark.thorough
def test_frames_are_located_by_the_features_that_come(tmp_path: Path) -> None:
    """Over a link, a set that never came is not there, nor those that depend on it."""
    link = {"link": "constant", "link_params": {"rate_kbps": 100_000, "loss": 0.01}}
    over_link = {"use": "localization", "params": {**link, "architecture": "features"}}
    codecs = ["raw", {"use": "orb_features", "params": {"mode": "inter"}}]
    run = codecbench.run(matrix("localization", over_link, codecs=codecs), out=tmp_path / "run")
    status = {(result.cell.codec.name, result.cell.evaluator.label): result.status for result in run.results}
    assert sorted(status.values()) == ["ok", "ok", "ok", "unsupported"]
    frames = {}
    for result in run.results:
        if result.status == "ok":
            found = result.frames()
            rows = found[found.metric == "tracked_inliers"]
            frames[result.cell.codec.name, result.cell.evaluator.params.get("link")] = rows.value.to_numpy()
    raw, sent, delivered = frames["raw", None], frames["orb_features", None], frames["orb_features", "constant"]
    assert np.array_equal(sent, raw, equal_nan=True)
    assert np.nanmax(raw) > 50
    lost = delivered != sent
    lost[np.isnan(sent)] = False
    assert lost.any()
    assert not lost.all()
    assert (delivered[lost] == 0).all()

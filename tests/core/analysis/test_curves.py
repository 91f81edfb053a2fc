"""Settings of a codec as curves: what is swept, and the order in which settings are joined."""

from __future__ import annotations

from codecbench.core.analysis.run_result import CurvePoint, curve_points
from codecbench.core.engine.planning.model import PluginSetting


def setting(name: str, **params: object) -> PluginSetting:
    return PluginSetting("codec", name, "1", params, " ".join(f"{key}={value}" for key, value in params.items()))


def test_settings_stand_in_the_order_of_what_is_swept_not_of_their_text() -> None:
    found = curve_points([setting("jpeg", quality=value) for value in (100, 9, 30)])
    assert sorted(found.values(), key=lambda point: point.place) == [
        CurvePoint("jpeg", "quality=9", 9.0),
        CurvePoint("jpeg", "quality=30", 30.0),
        CurvePoint("jpeg", "quality=100", 100.0),
    ]


def test_what_is_held_fixed_names_the_curve() -> None:
    swept = [setting("multilevel", qf=qf, levels=levels) for levels in (1, 2) for qf in (5, 20, 75)]
    found = curve_points([*swept, setting("raw")])
    assert found["multilevel", "qf=20 levels=2"] == CurvePoint("multilevel levels=2", "qf=20", 20.0)
    assert found["raw", ""] == CurvePoint("raw", "", 0.0)

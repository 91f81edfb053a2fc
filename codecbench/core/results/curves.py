"""Settings that belong to one curve: those of a codec that differ in nothing but how hard they compress."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from codecbench.core.engine.planning.model import PluginSetting


@dataclass(frozen=True)
class CurvePoint:
    """Where a setting stands: `curve` names the codec and what is held fixed, `point` what is swept.

    place: the value that is swept, by which the settings of a curve stand in order; 0 where nothing is.
    """

    curve: str
    point: str
    place: float = 0.0


def curve_points(settings: Iterable[PluginSetting]) -> dict[tuple[str, str], CurvePoint]:
    """The curve of each codec setting, by codec name and label.

    A codec's swept parameter is the number that takes most values over its settings; the other parameters
    that differ name the curve: `qf=5 levels=2` is point `qf=5` of the curve `multilevel levels=2`.
    """
    by_codec: dict[str, dict[str, PluginSetting]] = defaultdict(dict)
    for setting in settings:
        by_codec[setting.name].setdefault(setting.label, setting)
    points = {}
    for codec, members in by_codec.items():
        swept = _swept([setting.params for setting in members.values()])
        for label, setting in members.items():
            words = label.split(" ") if label else []
            held = [word for word in words if not (swept and word.startswith(f"{swept}="))]
            if len(members) == 1:
                points[codec, label] = CurvePoint(codec, label)
            else:
                point = " ".join(word for word in words if word not in held)
                value = setting.params.get(swept) if swept else None
                place = float(value) if isinstance(value, int | float) else 0.0
                points[codec, label] = CurvePoint(" ".join([codec, *held]), point, place)
    return points


def _swept(params: list[dict[str, object]]) -> str | None:
    """The numeric parameter with most different values; of equals the first."""
    best, most = None, 1
    for key in params[0] if params else ():
        values = [setting.get(key) for setting in params]
        numbers = {value for value in values if isinstance(value, int | float) and not isinstance(value, bool)}
        if len(numbers) > most:
            best, most = key, len(numbers)
    return best

"""The links that ship with codecbench, by reference, so that nothing heavy is imported until a cell needs it."""

from __future__ import annotations

from codecbench.core.contracts.hooks import PluginSpec, hookimpl

_HERE = "codecbench.plugins.links."
_PRESETS = _HERE + "presets:"


@hookimpl
def codecbench_links() -> list[PluginSpec]:
    return [
        PluginSpec("ideal", _HERE + "constant:Ideal", "everything arrives at once"),
        PluginSpec("constant", _HERE + "constant:Constant", "a rate, a delay, jitter, and packets lost independently"),
        PluginSpec("gilbert_elliott", _HERE + "gilbert_elliott:GilbertElliott", "packets lost in bursts: two states"),
        PluginSpec("trace", _HERE + "trace:Trace", "a Mahimahi trace: when 1,500 bytes could go"),
        PluginSpec("wifi_good", _PRESETS + "WifiGood", "Wi-Fi beside the access point"),
        PluginSpec("wifi_edge", _PRESETS + "WifiEdge", "Wi-Fi where it ends: slow, and lost in bursts"),
        PluginSpec("lte", _PRESETS + "Lte", "the way up of LTE, standing still"),
        PluginSpec(
            "lte_moving", _PRESETS + "LteMoving", "the way up of LTE from a vehicle: its rate swings, and it stops"
        ),
        PluginSpec("telemetry_900mhz", _PRESETS + "Telemetry900Mhz", "a long-range telemetry radio"),
        PluginSpec("satellite_leo", _PRESETS + "SatelliteLeo", "the way up to satellites in low orbit"),
        PluginSpec("underwater_acoustic", _PRESETS + "UnderwaterAcoustic", "sound through a kilometre of water"),
    ]

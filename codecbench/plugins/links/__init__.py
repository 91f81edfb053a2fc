"""The links that ship with codecbench, by reference, so that nothing heavy is imported until a cell needs it."""

from __future__ import annotations

from codecbench.core.contracts.hooks import PluginSpec, hookimpl

_HERE = "codecbench.plugins.links."
_PRESETS = _HERE + "presets:"


@hookimpl
def codecbench_links() -> list[PluginSpec]:
    return [
        PluginSpec("ideal", _HERE + "constant:Ideal", "every packet arrives at once"),
        PluginSpec("constant", _HERE + "constant:Constant", "a rate, a delay, jitter, and packets lost independently"),
        PluginSpec("gilbert_elliott", _HERE + "gilbert_elliott:GilbertElliott", "packets lost in bursts: two states"),
        PluginSpec("trace", _HERE + "trace:Trace", "a Mahimahi trace: times at which 1,500 bytes can be sent"),
        PluginSpec("wifi_good", _PRESETS + "WifiGood", "Wi-Fi near the access point"),
        PluginSpec("wifi_edge", _PRESETS + "WifiEdge", "Wi-Fi at the edge of its range: slow, with bursts of loss"),
        PluginSpec("lte", _PRESETS + "Lte", "LTE uplink, standing still"),
        PluginSpec("lte_moving", _PRESETS + "LteMoving", "LTE uplink from a vehicle: varying rate, outages"),
        PluginSpec("telemetry_900mhz", _PRESETS + "Telemetry900Mhz", "a long-range telemetry radio"),
        PluginSpec("satellite_leo", _PRESETS + "SatelliteLeo", "uplink to satellites in low orbit"),
        PluginSpec("underwater_acoustic", _PRESETS + "UnderwaterAcoustic", "acoustic modem through 1 km of water"),
    ]

"""Links that robots use, as settings of the other links. docs/link.md has the sources of the numbers."""

from __future__ import annotations

from codecbench.plugins.links.constant import Constant, ConstantParams
from codecbench.plugins.links.gilbert_elliott import GilbertElliott, GilbertElliottParams
from codecbench.plugins.links.queued import Duration, Share, Time
from codecbench.plugins.links.trace import Embedded, Trace, TraceParams


class WifiGoodParams(GilbertElliottParams):
    """Set the parameters of `gilbert_elliott`, which have other defaults here."""

    rate_kbps: Duration = 40_000.0
    delay_ms: Time = 2.0
    jitter_ms: Time = 1.0
    good_ms: Duration = 2_000.0
    bad_ms: Duration = 20.0
    good_loss: Share = 0.0005
    bad_loss: float = 0.2


class WifiGood(GilbertElliott):
    """Wi-Fi near the access point."""

    name = "wifi_good"
    params_type = WifiGoodParams


class WifiEdgeParams(GilbertElliottParams):
    """Set the parameters of `gilbert_elliott`, which have other defaults here."""

    rate_kbps: Duration = 6_000.0
    delay_ms: Time = 4.0
    jitter_ms: Time = 4.0
    good_ms: Duration = 800.0
    bad_ms: Duration = 120.0
    good_loss: Share = 0.01
    bad_loss: float = 0.6


class WifiEdge(GilbertElliott):
    """Wi-Fi at the edge of its range: slow, with bursts of loss."""

    name = "wifi_edge"
    params_type = WifiEdgeParams


class LteParams(TraceParams):
    """Set the parameters of `trace`, which have other defaults here."""

    trace: Embedded = "lte_still"
    delay_ms: Time = 35.0
    queue_packets: int = 512


class Lte(Trace):
    """LTE uplink, standing still."""

    name = "lte"
    params_type = LteParams


class LteMovingParams(LteParams):
    """Set the parameters of `trace`, which have other defaults here."""

    trace: Embedded = "lte_moving"


class LteMoving(Trace):
    """LTE uplink from a vehicle: varying rate, outages."""

    name = "lte_moving"
    params_type = LteMovingParams


class Telemetry900MhzParams(ConstantParams):
    """Set the parameters of `constant`, which have other defaults here."""

    rate_kbps: Duration = 200.0
    delay_ms: Time = 20.0
    jitter_ms: Time = 10.0
    loss: Share = 0.01
    queue_packets: int = 32


class Telemetry900Mhz(Constant):
    """A long-range telemetry radio."""

    name = "telemetry_900mhz"
    params_type = Telemetry900MhzParams


class SatelliteLeoParams(GilbertElliottParams):
    """Set the parameters of `gilbert_elliott`, which have other defaults here."""

    rate_kbps: Duration = 17_000.0
    delay_ms: Time = 20.0
    jitter_ms: Time = 5.0
    good_ms: Duration = 15_000.0
    bad_ms: Duration = 150.0
    good_loss: Share = 0.004
    bad_loss: float = 0.5


class SatelliteLeo(GilbertElliott):
    """Uplink to satellites in low orbit."""

    name = "satellite_leo"
    params_type = SatelliteLeoParams


class UnderwaterAcousticParams(ConstantParams):
    """Set the parameters of `constant`, which have other defaults here."""

    rate_kbps: Duration = 5.0
    delay_ms: Time = 667.0
    loss: Share = 0.05
    queue_packets: int = 16


class UnderwaterAcoustic(Constant):
    """Acoustic modem through 1 km of water."""

    name = "underwater_acoustic"
    params_type = UnderwaterAcousticParams

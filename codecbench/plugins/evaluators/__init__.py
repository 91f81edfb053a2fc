"""The evaluators that ship with codecbench, by reference, so that nothing heavy is imported until a cell needs it."""

from __future__ import annotations

from codecbench.core.contracts.hooks import PluginSpec, hookimpl

_HERE = "codecbench.plugins.evaluators."


@hookimpl
def codecbench_evaluators() -> list[PluginSpec]:
    return [
        PluginSpec("quality", _HERE + "quality:Quality", "rate, PSNR and structural similarity, frame by frame"),
        PluginSpec("features", _HERE + "features:Features", "what a feature-based tracker would lose"),
        PluginSpec("stream", _HERE + "stream:Stream", "bit rate, delay, and joining in the middle of a stream"),
        PluginSpec(
            "delivery", _HERE + "delivery:DeliveryEvaluator", "what arrives over a link, when, and how old it is"
        ),
        PluginSpec("timing", _HERE + "timing:Timing", "encode and decode time per frame, wall and CPU"),
        PluginSpec("operations", _HERE + "operations:Operations", "operations per stage, in the paper's seven classes"),
        PluginSpec(
            "trajectory",
            _HERE + "trajectory:TrajectoryEvaluator",
            "what SLAM on the decoded frames makes of the camera's path",
            requires=("evo",),
        ),
        PluginSpec(
            "localization",
            _HERE + "localization:Localization",
            "where each decoded frame is in a map of the raw frames, from the previous pose and from nothing",
            requires=("evo",),
        ),
        PluginSpec(
            "relative_pose",
            _HERE + "relative_pose:RelativePose",
            "the motion between two decoded frames, from their matches, pair by pair",
        ),
        PluginSpec(
            "place_recognition",
            _HERE + "place_recognition:PlaceRecognition",
            "whether decoded frames find the places that they revisit among raw ones",
        ),
    ]

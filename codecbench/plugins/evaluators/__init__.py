"""The evaluators that ship with codecbench, by reference, so that nothing heavy is imported until a cell needs it."""

from __future__ import annotations

from codecbench.core.contracts.hooks import PluginSpec, hookimpl

_HERE = "codecbench.plugins.evaluators."


@hookimpl
def codecbench_evaluators() -> list[PluginSpec]:
    return [
        PluginSpec("quality", _HERE + "quality:Quality", "rate, PSNR and structural similarity, frame by frame"),
        PluginSpec("features", _HERE + "features:Features", "keypoints and matches that a feature-based tracker loses"),
        PluginSpec("depth", _HERE + "depth:DepthEvaluator", "errors of distances, edges and surfaces of depth frames"),
        PluginSpec("stream", _HERE + "stream:Stream", "bit rate, coding delay and random access"),
        PluginSpec(
            "delivery", _HERE + "delivery:DeliveryEvaluator", "which frames arrive over a link, when, and their age"
        ),
        PluginSpec("timing", _HERE + "timing:Timing", "encode and decode time per frame, wall and CPU"),
        PluginSpec("operations", _HERE + "operations:Operations", "operations per stage, in the paper's seven classes"),
        PluginSpec(
            "trajectory",
            _HERE + "trajectory:TrajectoryEvaluator",
            "the camera path that SLAM estimates from the decoded frames",
            requires=("evo",),
        ),
        PluginSpec(
            "localization",
            _HERE + "localization:Localization",
            "the pose of each decoded frame in a map of the raw frames, by tracking and by relocalization",
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
            "whether decoded frames retrieve raw frames of the same place",
        ),
    ]

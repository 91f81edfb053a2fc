"""The SLAM backends that ship with codecbench, by reference."""

from __future__ import annotations

from codecbench.core.contracts.hooks import PluginSpec, hookimpl

_HERE = "codecbench.plugins.slam_backends."


@hookimpl
def codecbench_slam_backends() -> list[PluginSpec]:
    return [
        PluginSpec("orb", _HERE + "orb:Orb", "codecbench's own monocular ORB-SLAM: deterministic, one thread"),
        PluginSpec(
            "orbslam3",
            _HERE + "orbslam3:OrbSlam3",
            "ORB-SLAM3 in a child process, paced at the frame rate of the sequence",
            requires=("pyorbslam3",),
            extra="codecbench[orbslam3]",
        ),
    ]

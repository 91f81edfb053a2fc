"""Lists the datasets that ship with codecbench. A dataset's module is imported only when the dataset is opened."""

from __future__ import annotations

from codecbench.core.contracts.hooks import PluginSpec, hookimpl

_HERE = "codecbench.plugins.datasets"


@hookimpl
def codecbench_datasets() -> list[PluginSpec]:
    return [
        PluginSpec(
            "synthetic", f"{_HERE}.synthetic.dataset:Synthetic", "a rendered room with a loop, without a download"
        ),
        PluginSpec("tum", f"{_HERE}.tum:Tum", "TUM RGB-D benchmark layout: rgb.txt, groundtruth.txt"),
        PluginSpec("kitti", f"{_HERE}.kitti:Kitti", "KITTI odometry: sequences/NN, poses/NN.txt"),
        PluginSpec("euroc", f"{_HERE}.euroc:Euroc", "EuRoC MAV: mav0/cam0 with its body's ground truth"),
        PluginSpec("sevenscenes", f"{_HERE}.sevenscenes:SevenScenes", "7-Scenes, color or depth: frame-*.color.png"),
        PluginSpec("folder", f"{_HERE}.folder:Folder", "image files in a folder, in natural order"),
        PluginSpec("video", f"{_HERE}.video:Video", "any video file that OpenCV opens"),
        PluginSpec(
            "bag",
            f"{_HERE}.bag.dataset:Bag",
            "images in a ROS 1 bag, a ROS 2 bag or an MCAP file",
            requires=("rosbags",),
            extra="codecbench[bag]",
        ),
        PluginSpec(
            "lerobot",
            f"{_HERE}.lerobot:Lerobot",
            "a camera in an episode of a LeRobot dataset, format 2.1 or 3.0",
            requires=("av",),
            extra="codecbench[video]",
        ),
    ]

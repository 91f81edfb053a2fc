"""The datasets that ship with codecbench. Only references: nothing of a dataset is imported before it is opened."""

from __future__ import annotations

from codecbench.core.contracts.hooks import Offer, hookimpl

_HERE = "codecbench.plugins.datasets"


@hookimpl
def codecbench_datasets() -> list[Offer]:
    return [
        Offer("synthetic", f"{_HERE}.synthetic.dataset:Synthetic", "a rendered room with a loop, always there"),
        Offer("tum", f"{_HERE}.tum:Tum", "TUM RGB-D benchmark layout: rgb.txt, groundtruth.txt"),
        Offer("kitti", f"{_HERE}.kitti:Kitti", "KITTI odometry: sequences/NN, poses/NN.txt"),
        Offer("euroc", f"{_HERE}.euroc:Euroc", "EuRoC MAV: mav0/cam0 with its body's ground truth"),
        Offer("folder", f"{_HERE}.folder:Folder", "any image files of a folder, in natural order"),
        Offer("video", f"{_HERE}.video:Video", "any video file that OpenCV opens"),
    ]

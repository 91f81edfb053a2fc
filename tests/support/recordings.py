"""Small recordings in the layouts that datasets read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

CALIBRATION = "width: 48\nheight: 32\nfx: 40\nfy: 40\ncx: 24\ncy: 16\n"


def pictures(folder: Path, names: list[str], size: tuple[int, int] = (32, 48)) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        picture = np.random.default_rng(number).integers(0, 255, (*size, 3), np.uint8)
        assert cv2.imwrite(str(folder / name), picture)


def tum(folder: Path, *, calibrated: bool = True, truth: bool = True) -> Path:
    pictures(folder / "rgb", ["a.png", "b.png"])
    (folder / "rgb.txt").write_text("0.0 rgb/a.png\n0.1 rgb/b.png\n")
    if calibrated:
        (folder / "calib.yaml").write_text(CALIBRATION)
    if truth:
        (folder / "groundtruth.txt").write_text("0.0 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n")
    return folder


def kitti(folder: Path, truth: bool) -> Path:
    pictures(folder / "sequences" / "07" / "image_2", ["000000.png", "000001.png"])
    (folder / "sequences" / "07" / "times.txt").write_text("0.0\n0.1\n")
    rows = [f"P{n}: 40 0 24 0 0 40 16 0 0 0 1 0" for n in range(4)]
    (folder / "sequences" / "07" / "calib.txt").write_text("\n".join(rows) + "\n")
    if truth:
        (folder / "poses").mkdir()
        (folder / "poses" / "07.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2)
    return folder


def euroc(folder: Path) -> Path:
    camera = folder / "mav0" / "cam0"
    pictures(camera / "data", ["1.png", "2.png"])
    (camera / "data.csv").write_text("#t,name\n1000000000,1.png\n1100000000,2.png\n")
    (camera / "sensor.yaml").write_text(
        "rate_hz: 10\nresolution: [48, 32]\nintrinsics: [40, 40, 24, 16]\ndistortion_coefficients: [0, 0, 0, 0]\n"
        "T_BS:\n  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
    )
    return folder

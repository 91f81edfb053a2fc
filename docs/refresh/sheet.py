"""Write docs/images/worlds.jpg: of each world a frame at severity 0, 0.5 and 1. Print how pages show it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLDS

SHEET: Final = Path(__file__).parents[1] / "images" / "worlds.jpg"
_TILE: Final = (200, 150)


def main() -> None:
    rows = []
    for name, world in WORLDS.items():
        tiles = []
        for severity in (0.0, 0.5, 1.0):
            sequence = Synthetic.create(world=name, severity=severity).open()
            image = sequence.read(int(0.37 * len(sequence))).image
            width = image.shape[0] * 4 // 3
            left = (world.width - width) // 2
            tiles.append(cv2.resize(image[:, left : left + width], _TILE, interpolation=cv2.INTER_AREA))
        row = np.hstack(tiles)
        for color, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            place = (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45
            cv2.putText(row, f"{name}: severity 0, 0.5, 1", *place, color, thickness, cv2.LINE_AA)
        rows.append(row)
    if len(rows) % 2:
        rows.append(np.full_like(rows[0], 255))
    pairs = [np.hstack(rows[k : k + 2]) for k in range(0, len(rows), 2)]
    SHEET.write_bytes(cv2.imencode(".jpg", np.vstack(pairs)[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 65])[1].tobytes())
    print("![Every world at severity 0, 0.5 and 1](images/worlds.jpg)")


if __name__ == "__main__":
    main()

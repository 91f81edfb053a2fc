"""What the small run of the tests of exports is made of, and how to export from it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from click.testing import CliRunner, Result
from video_pictures import gliding_pictures

from codecbench.cli import cli

COUNT: Final = 6
STAMPS: Final = [f"1305031102.{place:06}" for place in (175304, 211214, 243211, 275326, 311267, 343227)]
TIMES_NS: Final = [int(stamp.replace(".", "")) * 1000 for stamp in STAMPS]
HEIGHT: Final = 66
WIDTH: Final = 98
MATRIX: Final = """
version: 1
name: glide
sequences: [{{use: tum, params: {{path: {path}, camera: none}}}}]
codecs:
  - jpeg
  - raw
  - {{use: h264, params: {{gop: 3, latency: {{grid: [low, any]}}}}}}
  - {{use: hevc, params: {{gop: 3}}}}
  - {{use: av1, params: {{gop: 3}}}}
  - {{use: vp9, params: {{gop: 3}}}}
evaluators: [quality]
run: {{workers: 1}}
"""


def frames() -> list[np.ndarray]:
    return gliding_pictures(COUNT, HEIGHT, WIDTH, 1)


def export(run: Path, *words: str) -> Result:
    return CliRunner().invoke(cli, ["export", str(run), *words])

"""Codecs whose pictures are not in their bitstreams: what they keep in their process is of no use to them."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from distributions import install_source
from installed_command import Place

from codecbench.core.analysis.collect import open_run

CHEATS = '''
import gc
import struct

import numpy as np
from codecbench import NULL_TRACE, Capabilities, Codec, NoParams, PluginSpec, hookimpl

KEPT = {}
STRIPS = 12


def key(image):
    return int(image.astype(np.uint64).sum() % 2**32)


class Cheat(Codec[NoParams]):
    version = "1"
    params_type = NoParams
    capabilities = Capabilities(channels=(1,), lossless=True)

    def encode(self, image, *, trace=NULL_TRACE):
        KEPT[key(image)] = image.copy()
        return struct.pack("<HHI", *image.shape, key(image))

    def decode(self, bitstream, *, trace=NULL_TRACE):
        *shape, number = struct.unpack("<HHI", bitstream)
        return self.found(shape, number)


class ModuleState(Cheat):
    """What was encoded, by its number."""

    name = "module_state"

    def found(self, shape, number):
        return KEPT.get(number, np.zeros(shape, np.uint8))


class Collector(Cheat):
    """Whatever picture of that sum there is in the process."""

    name = "collector"

    def found(self, shape, number):
        for one in gc.get_objects():
            for image in (one, getattr(one, "image", None)) if type(one).__name__ == "Frame" else (one,):
                if isinstance(image, np.ndarray) and list(image.shape) == shape and key(image) == number:
                    return image.copy()
        return np.zeros(shape, np.uint8)


class RepeatsLast(Cheat):
    """A strip of the picture; the rest is what was decoded last."""

    name = "repeats_last"
    capabilities = Capabilities(channels=(1,))
    last = None
    pushed = 0

    def encode(self, image, *, trace=NULL_TRACE):
        RepeatsLast.pushed += 1
        rows = image.shape[0] // STRIPS
        begin = RepeatsLast.pushed % STRIPS * rows
        return struct.pack("<HHH", *image.shape, begin) + image[begin : begin + rows].tobytes()

    def decode(self, bitstream, *, trace=NULL_TRACE):
        height, width, begin = struct.unpack("<HHH", bitstream[:6])
        if RepeatsLast.last is None:
            RepeatsLast.last = np.zeros((height, width), np.uint8)
        strip = np.frombuffer(bitstream[6:], np.uint8).reshape(-1, width)
        RepeatsLast.last[begin : begin + len(strip)] = strip
        return RepeatsLast.last


class Honest(Cheat):
    name = "honest"

    def encode(self, image, *, trace=NULL_TRACE):
        return struct.pack("<HH", *image.shape) + image.tobytes()

    def decode(self, bitstream, *, trace=NULL_TRACE):
        return np.frombuffer(bitstream[4:], np.uint8).reshape(struct.unpack("<HH", bitstream[:4]))


@hookimpl
def codecbench_codecs():
    codecs = (ModuleState, Collector, RepeatsLast, Honest)
    return [PluginSpec(codec.name, f"cheats:{codec.__name__}", "a test") for codec in codecs]
'''
MATRIX = """
version: 1
name: cheats
sequences: [{use: folder, name: still, params: {path: pictures}}]
codecs: [module_state, collector, repeats_last, honest]
evaluators: [quality]
run: {workers: 2}
"""
STATUSES = {"module_state": "ok", "collector": "ok", "repeats_last": "failed", "honest": "ok"}
FRAMES = 12
"""As many as strips: chance lets one order of 12 x 11 x 10 x 9 pass."""


def test_no_row_has_values_that_its_bytes_do_not_earn(tmp_path: Path) -> None:
    place = Place(tmp_path)
    install_source(place.site, "cheats", "1", CHEATS)
    (tmp_path / "pictures").mkdir()
    picture = np.random.default_rng(3).integers(100, 256, (24, 36), np.uint8)
    for number in range(FRAMES):
        cv2.imwrite(str(tmp_path / "pictures" / f"{number:02}.png"), picture)
    (tmp_path / "m.yaml").write_text(MATRIX)
    done = place.call("run", "m.yaml", "--out", "out", "--quiet")
    assert done.status == 1, done.output
    found = {result.cell.codec.name: result for result in open_run(tmp_path / "out").results}
    psnr = {name: result.summaries.get(("psnr_gray_db", "", "mean")) for name, result in found.items()}
    assert {name: result.status for name, result in found.items()} == STATUSES
    assert psnr.pop("honest") == math.inf
    assert psnr.pop("repeats_last") is None
    assert all(value is not None and 0 < value < 10 for value in psnr.values()), psnr
    assert "decode returns other" in found["repeats_last"].reason

"""Notes on frames that were compressed before."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
from skimage import data

from codecbench.plugins.datasets.files import jpeg_notes
from codecbench.plugins.datasets.folder import Folder
from codecbench.plugins.datasets.video import Video


def test_jpeg_files_are_recognized_and_broken_ones_distinguished() -> None:
    _, jpeg = cv2.imencode(".jpg", data.astronaut()[:64, :64], [cv2.IMWRITE_JPEG_QUALITY, 30])
    _, png = cv2.imencode(".png", data.astronaut()[:64, :64])
    (note,) = jpeg_notes(jpeg.tobytes())
    assert "JPEG of quality 30 " in note
    assert "decoded JPEG:" in jpeg_notes(b"\xff\xd8\xff" + bytes(40))[0]
    assert [jpeg_notes(content) for content in (png.tobytes(), b"")] == [(), ()]


def test_a_folder_and_a_video_say_what_their_frames_were(tmp_path: Path) -> None:
    frame = np.ascontiguousarray(data.astronaut()[:64, :64])
    cv2.imwrite(str(tmp_path / "0.jpg"), frame)
    assert "JPEG of quality 95" in Folder.create(path=tmp_path).open().notes[0]
    (tmp_path / "0.jpg").unlink()
    cv2.imwrite(str(tmp_path / "0.png"), frame)
    assert Folder.create(path=tmp_path).open().notes == ()
    for name, code, notes in (("a.avi", "MJPG", 1), ("b.avi", "FFV1", 0)):
        writer = cv2.VideoWriter(str(tmp_path / name), cv2.VideoWriter.fourcc(*code), 10.0, (64, 64))
        for _ in range(3):
            writer.write(frame)
        writer.release()
        assert len(Video.create(path=tmp_path / name).open().notes) == notes, name


def test_a_note_gives_the_part_of_a_recording_that_is_used(tmp_path: Path) -> None:
    for number in range(6):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((8, 8), np.uint8))
    assert Folder.create(path=tmp_path).open().notes == ()
    assert Folder.create(path=tmp_path, stop=4).open().notes[0].startswith("the first 4 of 6 ")
    (note,) = Folder.create(path=tmp_path, start=1, stride=2).open().notes
    assert re.findall(r"\d+", note) == ["3", "6", "1", "5", "2"]

"""Notes of who encoded are read as they were written, or not at all."""

from __future__ import annotations

import json
from pathlib import Path

from codecbench.core.engine.storage.bitstream_file import EncoderNotes


def test_a_note_is_read_by_whoever_opens_the_folder_next(tmp_path: Path) -> None:
    notes = EncoderNotes(tmp_path)
    notes.write("ab12", "codecbench 0.1.0 feed")
    assert notes.read("ab12") == EncoderNotes(tmp_path).read("ab12") == "codecbench 0.1.0 feed"
    assert notes.read("cd34") == ""


def test_every_flipped_bit_and_a_change_of_places_is_noticed(tmp_path: Path) -> None:
    EncoderNotes(tmp_path).write("ab12", "codecbench 0.1.0 feed")
    path = tmp_path / "ab12.code"
    whole = path.read_bytes()
    for bit in range(0, 8 * len(whole), 7):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(bytes(damaged))
        assert EncoderNotes(tmp_path).read("ab12") in ("", "codecbench 0.1.0 feed")
    (tmp_path / "cd34.code").write_bytes(whole)
    assert EncoderNotes(tmp_path).read("cd34") == ""
    path.write_text(json.dumps(["no", "note"]))
    assert EncoderNotes(tmp_path).read("ab12") == ""

"""Bags that are cut short, damaged or made by somebody who means harm."""

from __future__ import annotations

import bz2
import re
import sqlite3
import struct
import subprocess
import sys

import numpy as np
import pytest
from bag_files import FORMATS, BagWriter, bag_file, picture, time_ns, write_pictures

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.dataset import Bag
from codecbench.plugins.datasets.bag.expansion import MOST_BYTES, expanded
from codecbench.plugins.datasets.bag.recording import recording

COUNT = 40
KINDS = [(kind, None) for kind in FORMATS] + [("bag", "bz2"), ("bag", "lz4"), ("mcap", "chunks")]
CHUNK_BYTES = 10_000


@pytest.fixture(scope="module", params=KINDS, ids=lambda kind: "-".join(str(part) for part in kind))
def whole(request, tmp_path_factory):
    """A file of 40 pictures and a camera, of several chunks."""
    kind, compressed = request.param
    folder = tmp_path_factory.mktemp("whole")
    path = folder / ("a.bag" if kind == "bag" else "a")
    shape = (24, 32, 3) if kind == "bag" else (150, 200, 3)
    with BagWriter(path, kind, compressed, CHUNK_BYTES) as bag:
        for number in range(COUNT):
            bag.write("/image", bag.image(picture(number, shape), "rgb8", time_ns(number)), time_ns(number))
    return bag_file(path, kind), shape


def test_a_file_that_is_cut_reads_up_to_the_damage_and_says_so(whole, tmp_path):
    file, shape = whole
    content = file.read_bytes()
    counts = []
    # SQLite moves a table's first page of rows to where the table first outgrew a page, here after a fifth.
    kept = (99, 80, 50) if file.suffix == ".db3" else (99, 80, 50, 20)
    for percent in kept:
        cut = tmp_path / f"cut{percent}{file.suffix}"
        cut.write_bytes(content[: len(content) * percent // 100])
        sequence = Bag.create(path=cut).open()
        assert cut.name in sequence.notes[0]
        assert "cut short" in sequence.notes[0] or "damaged or was not closed" in sequence.notes[0]
        for frame in sequence:
            np.testing.assert_array_equal(frame.image, picture(frame.index, shape))
        counts.append(len(sequence))
    assert counts == sorted(counts, reverse=True)
    for percent, count in zip(kept, counts, strict=True):
        assert COUNT * percent / 100 - 12 <= count <= COUNT * percent / 100 + 1


def test_a_cut_sqlite_file_reads_messages_that_its_tree_does_not_reach(tmp_path):
    """The table has grown twice: what leads to its first messages lies after the 450th page of them, and is cut off."""
    with BagWriter(tmp_path / "a", "db3") as bag:
        for number in range(600):
            samples = picture(number, (46, 64))
            bag.write("/image", bag.image(samples, "mono8", time_ns(number)), time_ns(number))
    content = bag_file(tmp_path / "a", "db3").read_bytes()
    cut = tmp_path / "cut.db3"
    cut.write_bytes(content[: len(content) * 70 // 100])
    with sqlite3.connect(cut) as connection:
        connection.execute("PRAGMA writable_schema = ON")
        with pytest.raises(sqlite3.Error):
            connection.execute("SELECT rowid FROM messages ORDER BY rowid").fetchall()
    sequence = Bag.create(path=cut).open()
    assert 415 <= len(sequence) <= 420
    for index in (0, 200, len(sequence) - 1):
        np.testing.assert_array_equal(sequence.read(index).image, picture(index, (46, 64)))
    assert f"is cut short: {cut.stat().st_size} of {len(content)} bytes; what is left is read" in sequence.notes[0]
    assert f"/image: {len(sequence)} of sensor_msgs/msg/Image" in sequence.notes[1]


def test_a_sqlite_file_that_ends_in_zeros_is_read_up_to_them(tmp_path):
    """As a copy is that was given its room and then stopped."""
    write_pictures(tmp_path / "a", "db3", 40, camera=False)
    file = bag_file(tmp_path / "a", "db3")
    content = file.read_bytes()
    half = len(content) // 2
    file.write_bytes(content[:half] + bytes(len(content) - half))
    sequence = Bag.create(path=file).open()
    assert 15 <= len(sequence) <= 20
    for frame in sequence:
        np.testing.assert_array_equal(frame.image, picture(frame.index))
    assert "is damaged: " in sequence.notes[0]


def test_a_sqlite_file_with_its_log_beside_it_is_read_without_it_and_says_how_to_put_it_in(tmp_path):
    write_pictures(tmp_path / "a", "db3", 4, camera=False)
    file = bag_file(tmp_path / "a", "db3")
    (file.parent / f"{file.name}-wal").write_bytes(b"whatever")
    sequence = Bag.create(path=file).open()
    assert len(sequence) == 4
    assert "what is only in a.db3-wal is not read: `sqlite3 a.db3 'PRAGMA wal_checkpoint'`" in sequence.notes[0]


def test_a_file_that_is_cut_anywhere_gives_true_frames_or_an_error(whole, tmp_path):
    file, shape = whole
    content = file.read_bytes()
    cut = tmp_path / f"cut{file.suffix}"
    for length in np.random.default_rng(1).integers(0, len(content), 15).tolist():
        cut.write_bytes(content[:length])
        try:
            sequence = Bag.create(path=cut).open()
        except DatasetError:
            continue
        last = len(sequence) - 1
        np.testing.assert_array_equal(sequence.read(last).image, picture(last, shape))


def test_damaged_bytes_anywhere_give_frames_or_an_error(whole, tmp_path):
    file, _ = whole
    content = np.frombuffer(file.read_bytes(), np.uint8)
    rng = np.random.default_rng(2)
    damaged = tmp_path / f"damaged{file.suffix}"
    for _ in range(12):
        changed = content.copy()
        places = rng.integers(0, min(len(changed), 4000), 20)
        changed[np.where(rng.random(20) < 0.5, places, len(changed) - 1 - places)] = rng.integers(0, 256, 20)
        damaged.write_bytes(changed.tobytes())
        try:
            sequence = Bag.create(path=damaged).open()
            for index in range(0, len(sequence), 4):
                sequence.read(index)
        except DatasetError:
            continue


def test_a_chunk_that_is_damaged_inside_ends_the_frames_before_it(tmp_path):
    path = write_pictures(tmp_path / "a.bag", "bag", 9, "bz2", camera=False, chunk_bytes=3000)
    content = bytearray(path.read_bytes())
    places = [found.start() for found in re.finditer(b"BZh91AY&SY", content)]
    assert len(places) == 5
    content[places[2] + 20 : places[2] + 60] = bytes(40)
    path.write_bytes(content)
    sequence = Bag.create(path=path).open()
    assert [frame.image[0, 0].tolist() for frame in sequence] == [picture(n)[0, 0].tolist() for n in range(4)]
    assert any(note.startswith("only 4 of 9 frames are read, up to the damage: ") for note in sequence.notes)


def test_a_ros_1_bag_that_was_never_closed_is_read_whole(tmp_path):
    path = write_pictures(tmp_path / "a.bag", "bag", chunk_bytes=3000)
    content = path.read_bytes()
    (end,) = struct.unpack("<Q", content.partition(b"index_pos=")[2][:8])
    path.write_bytes(content[:end].replace(content.partition(b"index_pos=")[2][:8], bytes(8)))
    sequence = Bag.create(path=path).open()
    assert len(sequence) == 6
    assert "was not closed" in sequence.notes[0]
    assert sequence.camera is not None


def test_empty_files_and_other_files_are_refused(tmp_path):
    for kind in FORMATS:
        for content in (b"", b"hello", bytes(1000)):
            path = tmp_path / f"x.{kind}"
            path.write_bytes(content)
            with pytest.raises(DatasetError, match=r"x\."):
                Bag.create(path=path).open()


def ros1_record(data, **fields):
    header = b"".join(struct.pack("<I", len(n) + 1 + len(v)) + n.encode() + b"=" + v for n, v in fields.items())
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def test_a_chunk_that_expands_to_more_than_it_says_is_not_expanded_further(tmp_path):
    bomb = bz2.compress(bytes(20_000_000))
    assert len(expanded(bomb, "bz2", 1000)) == 1000
    chunk = ros1_record(bomb, op=b"\x05", compression=b"bz2", size=struct.pack("<I", 1000))
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + chunk)
    with pytest.raises(DatasetError, match="no picture is left"):
        Bag.create(path=tmp_path / "a.bag").open()


def test_a_chunk_that_claims_too_much_is_refused(tmp_path):
    chunk = ros1_record(bz2.compress(b"x"), op=b"\x05", compression=b"bz2", size=struct.pack("<I", MOST_BYTES + 1))
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n" + chunk)
    with pytest.raises(DatasetError, match=f"claims {MOST_BYTES + 1} bytes; at most {MOST_BYTES} are read"):
        Bag.create(path=tmp_path / "a.bag").open()


def test_an_index_that_points_nowhere_ends_the_frames_before_it(tmp_path):
    path = write_pictures(tmp_path / "a.bag", "bag", count=3, camera=False)
    content = bytearray(path.read_bytes())
    index = content.index(b"count=\x03\x00\x00\x00") + 10
    entries = content.index(struct.pack("<I", 36), index) + 4
    for number, frames in ((1, 1), (0, 0)):
        content[entries + 12 * number + 8 : entries + 12 * number + 12] = struct.pack("<I", 1 << 31)
        path.write_bytes(content)
        if frames:
            assert "no message at byte 2147483648 of chunk 0" in Bag.create(path=path).open().notes[1]
        else:
            with pytest.raises(DatasetError, match=r"a\.bag: no message at byte 2147483648 of chunk 0"):
                Bag.create(path=path).open()


def test_a_view_in_the_place_of_a_table_is_refused(tmp_path):
    path = write_pictures(tmp_path / "a", "db3") / "a.db3"
    with sqlite3.connect(path) as connection:
        connection.execute("ALTER TABLE messages RENAME TO real_messages")
        connection.execute("CREATE VIEW messages AS SELECT * FROM real_messages")
    with pytest.raises(DatasetError, match="holds no tables `topics` and `messages`"):
        Bag.create(path=path).open()


def test_definitions_of_messages_in_a_bag_are_never_used(tmp_path):
    """rosbags makes code of them; these are no definitions at all."""
    path = write_pictures(tmp_path / "a.bag", "bag")
    content = path.read_bytes()
    path.write_bytes(content.replace(b"uint32 height", b"import os;  #"))
    assert len(Bag.create(path=path).open()) == 6


def test_a_topic_of_two_types_is_refused(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    for number, name in enumerate(("Image", "CameraInfo")):
        with BagWriter(tmp_path / name, "mcap") as bag:
            message = bag.image(picture(0), "rgb8", 1) if name == "Image" else bag.camera_info()
            bag.write("/image", message, 5)
        bag_file(tmp_path / name, "mcap").rename(folder / f"{number}.mcap")
    with pytest.raises(DatasetError, match="topic /image has messages of"):
        Bag.create(path=folder).open()


def test_reading_a_frame_reads_no_more_than_its_message_or_its_chunk(whole, monkeypatch):
    """Random access is bounded: what is read for a frame does not grow with the file."""
    file, shape = whole
    if file.suffix == ".db3":
        return  # SQLite reads for itself
    sequence = Bag.create(path=file).open()
    read = []
    (bag,) = recording(file)._files
    original = bag._bytes
    monkeypatch.setattr(bag, "_bytes", lambda start, length: read.append(length) or original(start, length))
    chunk = max(chunk.stored_bytes for chunk in bag._chunks)
    for index in (35, 3, 20):
        read.clear()
        np.testing.assert_array_equal(sequence.read(index).image, picture(index, shape))
        assert sum(read) <= chunk + 70_000
    assert file.stat().st_size > 3 * chunk


READ_ALL = """
import resource
from pathlib import Path
from codecbench.plugins.datasets.bag.dataset import Bag
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
sequence = Bag.create(path=Path({path!r})).open()
sequence.fingerprint
for index in (len(sequence) - 1, 0, *range(0, len(sequence), 7)):
    sequence.read(index)
print(len(sequence), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.thorough
@pytest.mark.parametrize("kind", FORMATS)
def test_a_bag_of_400_mb_is_read_in_50_mb(tmp_path, kind):
    path = tmp_path / ("a.bag" if kind == "bag" else "a")
    shape = (480, 640, 3)
    with BagWriter(path, kind) as bag:
        samples = picture(0, shape)
        for number in range(430):
            samples[0, 0] = number % 256
            bag.write("/image", bag.image(samples, "rgb8", time_ns(number)), time_ns(number))
    assert bag_file(path, kind).stat().st_size > 390e6
    ran = subprocess.run(
        [sys.executable, "-c", READ_ALL.format(path=str(path))], capture_output=True, text=True, check=True
    )
    count, grown_kb = map(int, ran.stdout.split())
    assert count == 430
    assert grown_kb < 50_000

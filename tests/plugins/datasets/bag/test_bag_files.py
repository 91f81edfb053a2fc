"""Bags that are cut short, damaged or made by somebody who means harm."""

from __future__ import annotations

import os
import re
import shlex
import sqlite3
import subprocess
import sys

import numpy as np
import pytest
from bag_files import FORMATS, BagWriter, bag_file, picture, time_ns, write_pictures
from mcap.writer import Writer

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.dataset import Bag
from codecbench.plugins.datasets.bag.recording import open_recording

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


REMEDIES = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": ".recover"}


def test_a_file_that_is_cut_names_the_command_that_recovers_it(whole, tmp_path):
    file, _ = whole
    content = file.read_bytes()
    for percent in (99, 50):
        cut = tmp_path / f"cut{percent}{file.suffix}"
        cut.write_bytes(content[: len(content) * percent // 100])
        said = (
            rf"{cut.name}: cannot be read, is damaged or was not closed \(.+\); `.*{REMEDIES[file.suffix]}.*` recovers"
        )
        with pytest.raises(DatasetError, match=said):
            Bag.create(path=cut).open()


def test_frames_are_the_same_in_any_order_and_in_a_forked_process(whole):
    file, shape = whole
    sequence = Bag.create(path=file).open()
    for index in (35, 3, 4, 5, 4, 20, 0, 39):
        np.testing.assert_array_equal(sequence.read(index).image, picture(index, shape))
    child = os.fork()
    if not child:
        right = all((sequence.read(index).image == picture(index, shape)).all() for index in (1, 2, 30))
        os._exit(0 if right else 1)
    for index in (7, 8, 25):
        np.testing.assert_array_equal(sequence.read(index).image, picture(index, shape))
    assert os.waitpid(child, 0)[1] == 0


@pytest.mark.parametrize(("kind", "encoding", "profile"), [("bag", "ros1", "ros1"), ("db3", "cdr", "")])
def test_an_mcap_file_of_another_profile_is_read(tmp_path, kind, encoding, profile):
    path = write_pictures(tmp_path / ("a.bag" if kind == "bag" else "a"), kind, 5, camera=False)
    bag = open_recording(path)
    (topic,) = bag.topics.values()
    with open(tmp_path / "plain.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start(profile)
        schema = writer.register_schema("sensor_msgs/Image", "", b"")
        channel = writer.register_channel("/image", encoding, schema)
        for number in range(5):
            writer.add_message(channel, time_ns(number), bag.raw(topic, number), time_ns(number))
        writer.finish()
    ours, theirs = Bag.create(path=tmp_path / "plain.mcap").open(), Bag.create(path=path).open()
    assert ours.fingerprint == theirs.fingerprint
    np.testing.assert_array_equal(ours.timestamps_s, theirs.timestamps_s)


def test_a_sqlite_file_with_its_log_beside_it_is_read_without_it_and_says_how_to_put_it_in(tmp_path):
    write_pictures(tmp_path / "a", "db3", 4, camera=False)
    file = bag_file(tmp_path / "a", "db3")
    (file.parent / f"{file.name}-wal").write_bytes(b"whatever")
    sequence = Bag.create(path=file).open()
    assert len(sequence) == 4
    assert "a.db3-wal" in sequence.notes[0]
    (command,) = re.findall("`(.*?)`", sequence.notes[0])
    assert shlex.split(command) == ["sqlite3", "a.db3", "PRAGMA wal_checkpoint"]


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
    assert any(note.startswith("only 4 of 9 frames") for note in sequence.notes)


def test_empty_files_and_other_files_are_refused(tmp_path):
    for kind in FORMATS:
        for content in (b"", b"hello", bytes(1000)):
            path = tmp_path / f"x.{kind}"
            path.write_bytes(content)
            with pytest.raises(DatasetError, match=r"x\."):
                Bag.create(path=path).open()


def test_a_view_in_the_place_of_a_table_is_refused(tmp_path):
    path = write_pictures(tmp_path / "a", "db3") / "a.db3"
    with sqlite3.connect(path) as connection:
        connection.execute("ALTER TABLE messages RENAME TO real_messages")
        connection.execute("CREATE VIEW messages AS SELECT * FROM real_messages")
    with pytest.raises(DatasetError, match=r"a\.db3: cannot be "):
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
    with pytest.raises(DatasetError, match=r" /image .*/CameraInfo'.*/Image'"):
        Bag.create(path=folder).open()


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

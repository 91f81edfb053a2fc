"""Folders in both formats of LeRobot datasets, written here by their description with pyarrow and PyAV."""

from __future__ import annotations

import json
import multiprocessing
import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import gray_from_image, png_bytes
from codecbench.core.engine.plugins.registry import installed
from codecbench.plugins.codecs.video.library import load_av, preserve_scheduling
from codecbench.plugins.datasets.lerobot import Lerobot
from codecbench.trial.recording import recognize

pytest.importorskip("av", reason="PyAV is not installed")
av = load_av()

FPS = 30
LENGTHS = (40, 70, 25)
TOP, WRIST = "observation.images.top", "observation.images.wrist"
H264 = ("libx264", {"g": "40", "bf": "3", "x264-params": "b-pyramid=2"})
HEVC = ("libx265", {"x265-params": "keyint=20:bframes=4:open-gop=1:log-level=none"})
AV1 = ("libsvtav1", {"g": "2", "crf": "30", "preset": "12"})
V21, V30 = "v2.1", "v3.0"
OLD_VIDEO = f"videos/chunk-000/{TOP}/episode_000001.mp4"
OLD_ROWS = "data/chunk-000/episode_000001.parquet"


def picture(number):
    """Eight bars that are the bits of a number, red in the lower half."""
    bits = np.repeat(((number >> np.arange(8)) & 1).astype(np.uint8) * 200 + 20, 16)
    image = np.repeat(np.tile(bits, (96, 1))[:, :, None], 3, axis=2)
    image[48:, :, 1:] //= 4
    return image


def number_in(image):
    return int(((image[20, 8::16, 1] > 120) << np.arange(8)).sum())


def encode(file, codec, numbers, muxing=None):
    """Encode an episode as LeRobot does, from time 0."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with preserve_scheduling(), av.open(str(file), "w", options=muxing or {}) as container:
        stream = container.add_stream(codec[0], rate=FPS, options=codec[1])
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        for number in numbers:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture(number), "rgb24")))
        container.mux(stream.encode())


def concatenate(files, target):
    """Join videos without coding them again, with FFmpeg's concat demuxer, as LeRobot does."""
    listed = target.with_suffix(".txt")
    listed.write_text("".join(f"file '{file}'\n" for file in files))
    options = {"safe": "0"}
    with av.open(str(listed), format="concat", options=options) as parts, av.open(str(target), "w") as whole:
        stream = whole.add_stream_from_template(parts.streams.video[0], opaque=True)
        for packet in parts.demux(parts.streams.video[0]):
            if packet.dts is not None:
                packet.stream = stream
                whole.mux(packet)
    for file in (listed, *files):
        file.unlink()


def rows_of(episode, start, images=()):
    count = LENGTHS[episode]
    rows = {
        "timestamp": pa.array(np.arange(count, dtype=np.float32) / np.float32(FPS)),
        "frame_index": np.arange(count),
        "episode_index": np.full(count, episode),
        "index": start + np.arange(count),
    }
    for name in images:
        contents = [png_bytes(picture(start + row)) for row in range(count)]
        rows[name] = [{"bytes": content, "path": f"frame_{row:06d}.png"} for row, content in enumerate(contents)]
    return pa.table(rows)


def write_dataset(root, version, cameras, images=()):
    """cameras: codec by feature; frame i of the dataset has the number i in its picture."""
    starts = [sum(LENGTHS[:episode]) for episode in range(len(LENGTHS))]
    is_old = version == V21
    (root / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
    features = {
        name: {
            "dtype": "video" if name in cameras else "image",
            "shape": [96, 128, 3],
            "names": ["height", "width", "channels"],
            "info": {"video.codec": cameras[name][0].removeprefix("lib")} if name in cameras else None,
        }
        for name in (*cameras, *images)
    } | {"timestamp": {"dtype": "float32", "shape": [1], "names": None}}
    data = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    video = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
    if not is_old:
        data = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
        video = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    info = {
        "codebase_version": version, "robot_type": "so100", "fps": FPS, "chunks_size": 1000, "features": features,
        "total_episodes": len(LENGTHS), "data_path": data, "video_path": video if cameras else None,
    }  # fmt: skip
    (root / "meta" / "info.json").write_text(json.dumps(info))
    episodes = [
        {"episode_index": number, "tasks": [f"Pick up cube {number}"], "length": count}
        for number, count in enumerate(LENGTHS)
    ]
    for name, codec in cameras.items():
        parts = []
        if version == V30 and name == TOP:  # one encoding over the episodes, whose keyframes are not at their starts
            encode(root / video.format(video_key=name, chunk_index=0, file_index=0), codec, range(sum(LENGTHS)))
        for number, start in enumerate(starts):
            parts.append(root / video.format(video_key=name, episode_chunk=0, episode_index=number, chunk_index=0,
                                             file_index=90 + number))  # fmt: skip
            if is_old or name != TOP:
                encode(parts[-1], codec, range(start, start + LENGTHS[number]))
            if not is_old:
                facts = (0, 0, start / FPS, (start + LENGTHS[number]) / FPS)
                names = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
                episodes[number] |= {f"videos/{name}/{key}": fact for key, fact in zip(names, facts, strict=True)}
        if not is_old and name != TOP:
            concatenate(parts, root / video.format(video_key=name, chunk_index=0, file_index=0))
    tables = [rows_of(number, start, images) for number, start in enumerate(starts)]
    if is_old:
        (root / "meta" / "episodes.jsonl").write_text("".join(f"{json.dumps(episode)}\n" for episode in episodes))
    else:
        columns = {"data/chunk_index": 0, "data/file_index": 0, "stats/action/mean": [0.5]}
        table = pa.Table.from_pylist([episode | columns for episode in episodes])
        pq.write_table(table, root / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
        tables = [pa.concat_tables(tables)]
    for number, table in enumerate(tables):
        file = root / data.format(episode_chunk=0, episode_index=number, chunk_index=0, file_index=0)
        file.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, file)
    return root


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("lerobot")
    return {
        V21: write_dataset(root / "old", V21, {TOP: H264}),
        V30: write_dataset(root / "new", V30, {TOP: H264, WRIST: AV1, "observation.images.side": HEVC}),
        "pictures": write_dataset(root / "pictures", V30, {}, [TOP]),
    }


@pytest.fixture
def copy(folders, tmp_path):
    """Copies a dataset to a folder that may be damaged."""
    return lambda kind: Path(shutil.copytree(folders[kind], tmp_path / f"copy of {kind}"))


@pytest.mark.parametrize("episode", range(len(LENGTHS)))
@pytest.mark.parametrize(("version", "camera"), [(V21, "top"), (V30, "top"), (V30, "side"), (V30, "wrist")])
def test_frames_are_those_of_the_rows_in_any_order(folders, version, camera, episode):
    sequence = Lerobot.create(path=folders[version], camera=camera, episode=episode).open()
    start, count = sum(LENGTHS[:episode]), LENGTHS[episode]
    assert (len(sequence), sequence.channels, sequence.frame_rate_hz) == (count, 3, FPS)
    np.testing.assert_allclose(sequence.timestamps_s, np.arange(count) / FPS, atol=1e-6)
    straight = [frame.image for frame in sequence]
    assert [number_in(image) for image in straight] == list(range(start, start + count))
    for index in (count - 1, 0, 7, 6, 7, 7, count // 2, 1, 2, count - 2):
        np.testing.assert_array_equal(sequence.read(index).image, straight[index])
    file = next(folders[version].glob(f"videos/**/*{camera}*/**/*{f'_{episode:06d}' if version == V21 else ''}.mp4"))
    with av.open(str(file)) as container:
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    first = 0 if version == V21 else start
    np.testing.assert_array_equal(straight, decoded[first : first + count])


def test_another_process_reads_the_same(folders):
    sequence = Lerobot.create(path=folders[V30], camera="top", episode=1).open()
    straight = [frame.image for frame in sequence]
    sequence.read(10)
    with multiprocessing.get_context("fork").Pool(1, _inherit, (sequence,)) as pool:
        seen = pool.map(_read_inherited, (11, 5, 69), chunksize=3)
    for index, image in zip((11, 5, 69), seen, strict=True):
        np.testing.assert_array_equal(image, straight[index])
    np.testing.assert_array_equal(sequence.read(11).image, straight[11])


def _inherit(sequence):
    global _inherited
    _inherited = sequence


def _read_inherited(index):
    return _inherited.read(index).image


def test_opening_does_not_touch_other_episodes(folders, copy):
    """All packets of the first episode are overwritten in the file of three."""
    folder = copy(V30)
    file = folder / f"videos/{WRIST}/chunk-000/file-000.mp4"
    with av.open(str(file)) as container:
        places = [(each.pos, each.size) for each in container.demux(video=0) if each.size][: LENGTHS[0]]
    content = bytearray(file.read_bytes())
    for place, size in places:
        content[place : place + size] = bytes(size)
    file.write_bytes(content)
    kept, damaged = (Lerobot.create(path=each, camera=WRIST, episode=2).open() for each in (folders[V30], folder))
    assert damaged.fingerprint == kept.fingerprint
    assert [number_in(frame.image) for frame in damaged] == [number_in(frame.image) for frame in kept]
    with pytest.raises(DatasetError, match=r"frame 0 of the episode cannot be decoded|not a whole MP4"):
        Lerobot.create(path=folder, camera=WRIST, episode=0).open()


def test_selection_camera_notes_and_fingerprint(folders, copy):
    params = {"camera": TOP, "episode": 1}
    whole = Lerobot.create(path=folders[V30], **params).open()
    some = Lerobot.create(
        path=folders[V30], **params, start=5, stop=60, stride=10, skip=(15,), color="gray", fov_deg=90
    ).open()
    assert (len(some), some.channels, some.frame_rate_hz, some.camera.fx) == (5, 1, 3.0, pytest.approx(64.0))
    assert some.timestamps_s[1] == pytest.approx(25 / FPS)
    np.testing.assert_array_equal(some.read(1).image, gray_from_image(whole.read(25).image))
    assert whole.origin.kind == f"LeRobot dataset v3.0, {TOP}, episode 1"
    assert whole.notes[0] == "so100, 30 Hz, episode 1 of 3: Pick up cube 1"
    note = Lerobot.create(path=folders[V21], episode=1).open().notes[1]
    with av.open(str(folders[V21] / OLD_VIDEO)) as container:
        rate = f"{container.streams.video[0].bit_rate / 1e3:,.0f}"
    assert note.startswith(f"THE FRAMES ARE ALREADY CODED: they are h264 video, yuv420p, {rate} kbit/s; `raw` includes")
    assert Lerobot.create(path=copy(V30), **params).open().fingerprint == whole.fingerprint
    others = [{"episode": 2}, {"camera": WRIST}, {"stop": 60}, {"color": "gray"}]
    prints = {Lerobot.create(path=folders[V30], **{**params, **other}).open().fingerprint for other in others}
    assert len(prints | {whole.fingerprint}) == 5
    (folders[V30] / "calib.yaml").write_text("{width: 640, height: 480, fx: 500, fy: 500, cx: 320, cy: 240}")
    with pytest.raises(DatasetError, match=r"is 128x96, but the calibration is for 640x480"):
        Lerobot.create(path=folders[V30], **params, calibration=folders[V30] / "calib.yaml").open()


def test_pictures_in_the_rows(folders, copy):
    sequence = Lerobot.create(path=folders["pictures"], episode=2).open()
    first = LENGTHS[0] + LENGTHS[1]
    for index in (3, 0, 24):
        np.testing.assert_array_equal(sequence.read(index).image, picture(first + index))
    assert (len(sequence), len(sequence.notes)) == (LENGTHS[2], 1)
    folder = copy("pictures")
    file = next(folder.glob("data/*/*.parquet"))
    rows = pq.read_table(file).to_pylist()
    rows[-1][TOP]["bytes"] = None
    pq.write_table(pa.Table.from_pylist(rows), file)
    with pytest.raises(DatasetError, match=r"row 24 of .* \(0 bytes\)") as caught:
        Lerobot.create(path=folder, episode=2).open().read(24)
    assert caught.value.without == {"skip": [24]}


def test_try_recognizes_a_folder_and_asks_for_the_camera(folders):
    for path in (folders[V21], folders[V21] / "meta"):
        found = recognize(installed(), path, {"episode": 1})
        assert (found.dataset, found.frames, found.width, found.height) == ("lerobot", LENGTHS[1], 128, 96)
    listed = f"3 cameras; choose one with `camera`:\n  {TOP}: 128x96, video x264\n  {WRIST}: 128x96, video svtav1\n"
    with pytest.raises(DatasetError, match=re.escape(listed)) as caught:
        recognize(installed(), folders[V30], {})
    assert "--set camera=VALUE" in str(caught.value)
    for params, fault in (({"camera": "left"}, "'left' is not the name of"), ({"episode": 3}, "has 3 episodes, .* 3")):
        with pytest.raises(DatasetError, match=fault):
            Lerobot.create(path=folders[V30], **{"camera": "top", **params}).open()


def edit_info(folder, **facts):
    file = folder / "meta" / "info.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **facts}))


@pytest.mark.parametrize(
    ("kind", "damage", "fault"),
    [
        (V21, lambda folder: (folder / "meta/info.json").unlink(), "info.json: cannot be read: No such file"),
        (V21, lambda folder: (folder / "meta/info.json").write_text('{"fps": 30'), "info.json: .* Invalid JSON: EOF"),
        (V21, lambda folder: edit_info(folder, fps=-1), r"fps: Input should be greater than 0, not -1"),
        (V21, lambda folder: edit_info(folder, codebase_version="v1.6"), r"'v3.0', not 'v1.6'; convert .*_v1_to_v2"),
        (V21, lambda folder: edit_info(folder, video_path="{nothing}"), r"where episode 1 is: KeyError\('nothing'\)"),
        (V21, lambda folder: edit_info(folder, features={}), r"not the name of .* there is none"),
        (V21, lambda folder: (folder / "meta/episodes.jsonl").unlink(), "episodes.jsonl: cannot be read: "),
        (V21, lambda folder: (folder / "meta/episodes.jsonl").write_text("{]"), r"episodes.jsonl: cannot be .* JSON"),
        (V30, lambda folder: shutil.rmtree(folder / "meta/episodes"), "episodes: cannot be read: "),
        (V21, lambda folder: (folder / OLD_ROWS).unlink(), "episode_000001.parquet: cannot be read: "),
        (V21, lambda folder: (folder / OLD_ROWS).write_bytes(b"PAR1"), "episode_000001.parquet: cannot be read: "),
        (V21, lambda folder: (folder / OLD_VIDEO).unlink(), "episode_000001.mp4: is missing or not a whole MP4"),
        (V21, lambda folder: cut(folder / OLD_VIDEO), "episode_000001.mp4: is missing or not a whole MP4 video: "),
    ],
)  # fmt: skip
def test_damage_is_an_error_that_names_the_file(copy, kind, damage, fault):
    folder = copy(kind)
    damage(folder)
    with pytest.raises(DatasetError, match=fault):
        Lerobot.create(path=folder, camera="top", episode=1).open()


def cut(file):
    content = file.read_bytes()
    file.write_bytes(content[: len(content) * 2 // 3])


def test_a_video_with_other_frames_than_rows_opens_as_far_as_both_go(copy):
    folder = copy(V21)
    encode(folder / OLD_VIDEO, H264, range(40, 90))
    with pytest.raises(DatasetError, match=r"has 50 frames for the 70 rows .* set `stop: 50`") as caught:
        Lerobot.create(path=folder, episode=1).open()
    sequence = Lerobot.create(path=folder, episode=1, **caught.value.without).open()
    assert [number_in(frame.image) for frame in sequence] == list(range(40, 90))
    assert any("has 50 frames for the 70 rows" in note for note in sequence.notes)
    encode(folder / OLD_VIDEO, H264, range(40, 120))
    with pytest.raises(DatasetError, match=r"has 80 frames for the 70 rows .* set `stop: 70`"):
        Lerobot.create(path=folder, episode=1).open()
    encode(folder / OLD_VIDEO, H264, range(40, 110), {"movflags": "faststart"})
    cut(folder / OLD_VIDEO)
    with pytest.raises(DatasetError, match=r"for the 70 rows .* set `stop: ") as caught:
        Lerobot.create(path=folder, episode=1).open()
    sequence = Lerobot.create(path=folder, episode=1, **caught.value.without).open()
    assert [number_in(frame.image) for frame in sequence] == list(range(40, 40 + len(sequence)))
    assert 20 < len(sequence) < 70

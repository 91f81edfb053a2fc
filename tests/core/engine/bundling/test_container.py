"""Bundles that strangers made to do harm: each is refused with its reason, and leaves nothing behind."""

from __future__ import annotations

import hashlib
import json
import shutil
import stat
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from kept_runs import write_kept_run

from codecbench import StoreError
from codecbench.core.engine.bundling import container, packing
from codecbench.core.engine.bundling.packing import unpack_bundle, write_bundle

Members = list[tuple[zipfile.ZipInfo, bytes]]
CELL = "ab" * 16
RECORD = f"records/ab/{CELL}"


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    write_kept_run(folder / "run")
    return write_bundle(folder / "run").path


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Path]:
    """A folder for a bundle, in which nothing but it may be when the test ends."""
    (tmp_path / "in").mkdir()
    yield tmp_path / "in"
    assert [path.name for path in tmp_path.rglob("*")] == ["in", "hostile.zip"]


def members_of(path: Path) -> Members:
    with zipfile.ZipFile(path) as archive:
        return [(info, archive.read(info)) for info in archive.infolist()]


def refused(place: Path, members: Members, match: str, *, listed: bool = True) -> None:
    """Writes the members as a bundle, its manifest naming all of them unless `listed` is false, and opens it."""
    path = place / "hostile.zip"
    content = {info.filename: data for info, data in members}
    manifest = json.loads(content["manifest.json"])
    if listed:
        manifest["files"] = {
            name: {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
            for name, data in content.items()
            if name != "manifest.json"
        }
    with zipfile.ZipFile(path, "w") as archive:
        for info, data in members:
            if info.filename == "manifest.json":
                data = json.dumps(manifest).encode()
            archive.writestr(info, data, zipfile.ZIP_DEFLATED)
    refused_file(path, match)


def refused_file(path: Path, match: str) -> None:
    with pytest.raises(StoreError, match=match) as caught:
        unpack_bundle(path, path.parent / "new" / "opened")
    assert caught.value.__cause__ is not None  # the file is at fault, and not what was asked for
    assert not (path.parent / "new").exists()


@pytest.mark.parametrize(
    "name",
    [
        "../escaped", "/etc/cron.d/escaped", "records/../../escaped", f"{RECORD}/../../../escaped", "C:\\escaped",
        f"{RECORD}/..\\..\\escaped", f"{RECORD}/.hidden", f"{RECORD}/sub/file.txt", "run.log", "lock",
        "report/report.html", "conftest.py", "records/cd/" + CELL + "/record.json", f"{RECORD}/{'a' * 300}",
        f"{RECORD}/a\nb",
        f"{RECORD}/\u202etxt",
        f"{RECORD}/", "environment/../plan.json", "coded/x.bits", "records/index.jsonl", "<img src=x onerror=alert(1)>",
    ],
)  # fmt: skip
def test_a_name_that_is_none_of_a_runs_files(sound: Path, place: Path, name: str) -> None:
    refused(place, [*members_of(sound), (zipfile.ZipInfo(name), b"harm")], "not the name|is a link")


def test_a_name_with_a_zero_byte(sound: Path, place: Path) -> None:
    path = place / "hostile.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for info, data in [*members_of(sound), (zipfile.ZipInfo(f"{RECORD}/aXb"), b"harm")]:
            archive.writestr(info, data)
    path.write_bytes(path.read_bytes().replace(b"aXb", b"a\0b"))
    refused_file(path, "not the name")


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFBLK, stat.S_IFSOCK, stat.S_IFDIR])
def test_links_folders_and_devices(sound: Path, place: Path, kind: int) -> None:
    info = zipfile.ZipInfo(f"{RECORD}/trajectory.txt")
    info.external_attr = (kind | 0o777) << 16
    refused(place, [*members_of(sound), (info, b"/etc/passwd")], "is a link, a folder or a device")


def test_two_files_of_one_name(sound: Path, place: Path) -> None:
    with pytest.warns(UserWarning, match="Duplicate name"):
        refused(place, [*members_of(sound), (zipfile.ZipInfo("plan.json"), b"{}")], "two files 'plan.json'")


def test_a_file_that_the_manifest_does_not_name(sound: Path, place: Path) -> None:
    extra = (zipfile.ZipInfo(f"{RECORD}/extra.txt"), b"smuggled")
    refused(place, [*members_of(sound), extra], r"extra\.txt.*manifest\.json", listed=False)


@pytest.mark.parametrize("name", ["manifest.json", "plan.json", "matrix.yaml"])
def test_what_every_bundle_has(sound: Path, place: Path, name: str) -> None:
    path = place / "hostile.zip"
    members = [(info, data) for info, data in members_of(sound) if info.filename != name]
    with zipfile.ZipFile(path, "w") as archive:
        for info, data in members:
            archive.writestr(info, data)
    refused_file(path, name)


def test_a_file_that_is_not_what_was_bundled(sound: Path, place: Path) -> None:
    members = [
        (info, data.replace(b"1.5", b"0.5") if info.filename.endswith("record.json") else data)
        for info, data in members_of(sound)
    ]
    refused(place, members, "is not what was bundled", listed=False)


@pytest.mark.parametrize(
    ("ending", "match"),
    [
        ("plan.json", r"hostile\.zip .*plan\.json is"),
        ("record.json", "none of its 2 cells"),
        ("trajectory.txt", "none of its 2 cells"),
    ],
)
def test_a_run_that_was_damaged_before_it_was_bundled(sound: Path, place: Path, ending: str, match: str) -> None:
    members = [(info, data[:-9] if info.filename.endswith(ending) else data) for info, data in members_of(sound)]
    refused(place, members, match)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("format", 2), ("format", "1"), ("cells", -1), ("cells", "many"), ("files", []), ("statuses", {"ok": "all"}),
        ("name", 5), ("bitstreams", "yes"),
    ],
)  # fmt: skip
def test_a_manifest_of_another_shape(sound: Path, place: Path, field: str, value: Any) -> None:
    members = [
        (info, json.dumps({**json.loads(data), field: value}).encode() if info.filename == "manifest.json" else data)
        for info, data in members_of(sound)
    ]
    refused(place, members, "is refused", listed=False)


def test_a_manifest_without_an_end(sound: Path, place: Path) -> None:
    members = [(i, b"[" * 100_000 if i.filename == "manifest.json" else data) for i, data in members_of(sound)]
    path = place / "hostile.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for info, data in members:
            archive.writestr(info, data)
    refused_file(path, "nested too deeply|is refused")


def test_a_file_that_unpacks_to_very_much(sound: Path, place: Path) -> None:
    bomb = (zipfile.ZipInfo(f"{RECORD}/frames.parquet"), bytes(100_000_000))
    refused(place, [*members_of(sound), bomb], r" 100,\d+,\d+; at most 7\d,")


def test_a_size_that_is_a_lie(sound: Path, place: Path) -> None:
    """The list at the end says 5 bytes where there are many: no more than is said is unpacked, and that is refused."""
    path = place / "hostile.zip"
    content = bytes(1_000_000)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for info, data in members_of(sound):
            if info.filename == "manifest.json":
                found = json.loads(data)
                found["files"][f"{RECORD}/liar.txt"] = {"size": 5, "sha256": hashlib.sha256(content).hexdigest()}
                data = json.dumps(found).encode()
            archive.writestr(info, data)
        archive.writestr(f"{RECORD}/liar.txt", content)
    path.write_bytes(path.read_bytes().replace(struct.pack("<L", 1_000_000), struct.pack("<L", 5)))
    refused_file(path, "is refused: ")


def test_files_that_lie_over_each_other(sound: Path, place: Path) -> None:
    path = place / "hostile.zip"
    path.write_bytes(sound.read_bytes())
    with zipfile.ZipFile(path) as archive:
        first, second = archive.infolist()[:2]
        directory = archive.start_dir
    content = bytearray(path.read_bytes())
    at = content.index(second.filename.encode(), directory) - 46
    content[at + 42 : at + 46] = struct.pack("<L", first.header_offset + 1)
    path.write_bytes(content)
    refused_file(path, "overlaps another file|Overlapped|is refused")


def test_too_many_files(sound: Path, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(container, "MOST_FILES", 5)
    refused(place, members_of(sound), r"\d+ files; at most 5")


def test_a_list_of_files_that_is_too_long(sound: Path, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(container, "_LARGEST_DIRECTORY", 100)
    refused(place, members_of(sound), "list of files")


def test_a_file_that_is_too_large(sound: Path, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(container, "largest_bytes", lambda name: 10)
    refused(place, members_of(sound), "at most 10 ")


def test_encrypted_or_packed_otherwise(sound: Path, place: Path) -> None:
    path = place / "hostile.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for info, data in members_of(sound):
            archive.writestr(info, data, zipfile.ZIP_LZMA)
    refused_file(path, "packed by another method")
    content = bytearray(sound.read_bytes())
    at = content.index(b"PK\x01\x02")
    content[at + 8] |= 1
    path.write_bytes(content)
    refused_file(path, "encrypted")


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"", lambda content: b"PK", lambda content: content[: len(content) // 2],
        lambda content: content + b"more", lambda content: b"\x1f\x8b" + content[2:-22], lambda content: content[-22:],
        lambda content: bytes(1000), lambda content: content[:40] + bytes(200) + content[240:],
        lambda content: content[:-22] + b"PK\x05\x06" + b"\xff" * 16 + b"\0\0",
        lambda content: content[:-22] + b"PK\x06\x07" + b"\xff" * 16 + content[-22:],
    ],
)  # fmt: skip
def test_files_that_are_no_bundle(sound: Path, place: Path, damage: Callable[[bytes], bytes]) -> None:
    path = place / "hostile.zip"
    path.write_bytes(damage(sound.read_bytes()))
    refused_file(path, "is refused")


def test_any_byte_that_is_not_as_it_was(sound: Path, place: Path, tmp_path: Path) -> None:
    """Wherever a bit turns, the bundle is refused, or what is unpacked is what was bundled."""
    content, path = sound.read_bytes(), place / "hostile.zip"
    unpack_bundle(sound, tmp_path / "whole")
    expected = {file.relative_to(tmp_path / "whole"): file.read_bytes() for file in files(tmp_path / "whole")}
    refusals = 0
    for at in range(0, len(content), 41):
        path.write_bytes(content[:at] + bytes([content[at] ^ 0x10]) + content[at + 1 :])
        try:
            unpack_bundle(path, place / "opened")
        except StoreError:
            refusals += 1
            continue
        assert {file.relative_to(place / "opened"): file.read_bytes() for file in files(place / "opened")} == expected
        shutil.rmtree(place / "opened")
    shutil.rmtree(tmp_path / "whole")
    assert refusals > 50


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def test_a_disk_without_room(sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = type("Usage", (), {"free": 10})
    monkeypatch.setattr(packing.shutil, "disk_usage", lambda folder: usage)
    with pytest.raises(StoreError, match="has 10 free"):
        unpack_bundle(sound, tmp_path / "opened")


def test_a_folder_that_is_there_is_left_alone(sound: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    with pytest.raises(StoreError, match="already exists"):
        unpack_bundle(sound, tmp_path / "mine")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(StoreError, match="already exists"):
        unpack_bundle(sound, tmp_path / "link")
    with pytest.raises(StoreError, match="no such file"):
        unpack_bundle(tmp_path / "absent.zip", tmp_path / "opened")

"""Fetching, with the real code against a server on this machine."""

from __future__ import annotations

import hashlib
import io
import re
import tarfile
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets import catalog, download
from codecbench.plugins.datasets.catalog import CatalogEntry, fetch_entry
from codecbench.plugins.datasets.download import ResumingDownloader, unpack


class Server(ThreadingHTTPServer):
    """Serves `files`; cuts the next answers after as many bytes as `cuts` says; refuses with `refusals`."""

    daemon_threads = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.files, self.cuts, self.refusals, self.asked = {}, [], [], []
        self.version = '"one"'
        threading.Thread(target=self.serve_forever, args=(0.01,), daemon=True).start()

    def url(self, name):
        return f"http://127.0.0.1:{self.server_port}/{name}"


class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        server = self.server
        wanted = self.headers.get("Range")
        server.asked.append(wanted)
        content = server.files.get(self.path[1:])
        if content is None or server.refusals:
            self.send_error(server.refusals.pop(0) if content is not None else 404)
            return
        start = 0
        if wanted and self.headers.get("If-Range") == server.version:
            start = int(wanted.removeprefix("bytes=").removesuffix("-"))
            if start >= len(content):
                self.send_error(416)
                return
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(content) - start))
        self.send_header("ETag", server.version)
        self.end_headers()
        stop = start + server.cuts.pop(0) if server.cuts else len(content)
        self.wfile.write(content[start:stop])
        self.wfile.flush()
        self.close_connection = True

    def log_message(self, *arguments):
        pass


@pytest.fixture
def server():
    server = Server()
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("CODECBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(download.time, "sleep", lambda seconds: None)
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "cache"


def tar_of(members):
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as archive:
        for name, content in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return buffer.getvalue()


def zip_of(members):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def entry(server, file="some.tgz", **values):
    defaults = {"kind": "tum", "homepage": "", "licence": "CC0", "citation": "nobody", "urls": (server.url(file),)}
    return CatalogEntry(name="some", **{**defaults, **values})


CONTENT = {"top/rgb.txt": b"list", "top/rgb/1.png": b"picture" * 4000, "top/depth/1.png": b"not needed"}


def test_an_archive_is_fetched_and_unpacked(server, own_cache):
    server.files["some.tgz"] = tar_of(CONTENT)
    progress = []
    wanted = entry(server, inside="top", leave_out=("*/depth/*",))
    assert not wanted.is_there
    folder = fetch_entry(wanted, lambda name, done, total: progress.append((name, done, total)))
    assert folder == own_cache / "data" / "some"
    assert {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()} == {"rgb.txt", "rgb/1.png"}
    assert (folder / "rgb/1.png").read_bytes() == CONTENT["top/rgb/1.png"]
    size = len(server.files["some.tgz"])
    assert progress[-1] == ("some.tgz", size, size)
    fetch_entry(wanted)
    assert len(server.asked) == 1
    assert not list(own_cache.rglob("*.tgz*"))


def test_single_files_become_a_folder(server):
    server.files |= {"a.png": b"first", "b.png": b"second"}
    folder = fetch_entry(entry(server, urls=(server.url("a.png"), server.url("b.png"))))
    assert sorted(file.name for file in folder.iterdir()) == ["a.png", "b.png"]
    assert (folder / "b.png").read_bytes() == b"second"


def test_zip_archives_too(server):
    server.files["some.zip"] = zip_of({"mav0/cam0/data.csv": b"x", "__MACOSX/y": b"z"})
    folder = fetch_entry(entry(server, "some.zip", leave_out=("__MACOSX/*",)))
    assert [str(file.relative_to(folder)) for file in folder.rglob("*.*")] == ["mav0/cam0/data.csv"]


def test_a_cut_connection_goes_on_where_it_stopped(server):
    server.files["some.tgz"] = tar_of(CONTENT)
    server.cuts = [100, 50]
    fetch_entry(entry(server, inside="top"))
    assert server.asked == [None, "bytes=100-", "bytes=150-"]


def test_giving_up_keeps_what_came_for_the_next_call(server, own_cache, rng):
    server.files["some.tgz"] = tar_of({"top/x": rng.bytes(20_000)})
    server.cuts = [10_000, 0, 0, 0, 0]
    with pytest.raises(DatasetError, match="after 10000 bytes; fetch"):
        fetch_entry(entry(server, inside="top"))
    (partial,) = (own_cache / "data" / ".partial").glob("*.tgz")
    assert partial.read_bytes() == server.files["some.tgz"][:10_000]
    server.asked.clear()
    assert (fetch_entry(entry(server, inside="top")) / "x").stat().st_size == 20_000
    assert server.asked == ["bytes=10000-"]
    assert not list((own_cache / "data" / ".partial").iterdir())


def test_a_file_that_changed_meanwhile_is_fetched_anew(server, rng):
    server.files["some.tgz"] = tar_of({"top/x": rng.bytes(20_000)})
    server.cuts = [10_000, 0, 0, 0, 0]
    with pytest.raises(DatasetError):
        fetch_entry(entry(server, inside="top"))
    server.files["some.tgz"], server.version = tar_of({"top/x": b"new" * 9000}), '"two"'
    assert (fetch_entry(entry(server, inside="top")) / "x").read_bytes() == b"new" * 9000


def test_a_part_that_is_already_whole_is_no_trap(server, own_cache):
    server.files["some.tgz"] = tar_of(CONTENT)
    partial = own_cache / "data" / ".partial" / "some-some.tgz"
    partial.parent.mkdir(parents=True)
    partial.write_bytes(server.files["some.tgz"])
    partial.with_name(partial.name + ".version").write_text('"one"')
    fetch_entry(entry(server, inside="top"))


def test_a_busy_server_is_asked_again_and_a_missing_file_is_not(server):
    server.files["some.tgz"] = tar_of(CONTENT)
    server.refusals = [503, 500]
    fetch_entry(entry(server, inside="top"))
    assert len(server.asked) == 3
    server.asked.clear()
    with pytest.raises(DatasetError, match=r"gone\.tgz: .* 404 "):
        fetch_entry(CatalogEntry("gone", "tum", "", "", "", urls=(server.url("gone.tgz"),)))
    assert len(server.asked) == 1


def test_no_server_at_all(server):
    url = server.url("some.tgz")
    server.shutdown()
    server.server_close()
    with pytest.raises(DatasetError, match=r"refused.* after 0 bytes"):
        fetch_entry(CatalogEntry("x", "tum", "", "", "", urls=(url,)))


def test_a_wrong_checksum_is_refused_and_deleted(server, own_cache):
    server.files["some.tgz"] = tar_of(CONTENT)
    with pytest.raises(
        DatasetError, match=rf"^{re.escape(server.url('some.tgz'))}: .*catalog's: {'0' * 64}\).*deleted"
    ):
        fetch_entry(entry(server, sha256=("0" * 64,)))
    assert not list(own_cache.rglob("*.tgz"))
    right = hashlib.sha256(server.files["some.tgz"]).hexdigest()
    assert fetch_entry(entry(server, sha256=(right,))).is_dir()


def test_the_first_fetch_records_the_checksum_and_later_ones_must_match(server, own_cache):
    import shutil

    server.files["some.tgz"] = tar_of(CONTENT)
    folder = fetch_entry(entry(server))
    digest = hashlib.sha256(server.files["some.tgz"]).hexdigest()
    assert (own_cache / "data" / "some.sha256").read_text() == f"{digest}  some.tgz\n"
    shutil.rmtree(folder)
    server.files["some.tgz"] = tar_of({"top/other": b"changed"})
    with pytest.raises(DatasetError, match=rf"/some\.sha256: {digest}\)"):
        fetch_entry(entry(server))


def test_a_folder_that_cannot_be_written(server, tmp_path, monkeypatch):
    server.files["some.tgz"] = tar_of(CONTENT)
    (tmp_path / "in the way").write_text("a file")
    monkeypatch.setenv("CODECBENCH_CACHE", str(tmp_path / "in the way"))
    with pytest.raises(DatasetError, match="cannot be written"):
        fetch_entry(entry(server))


def test_two_at_once_do_not_mix(server, tmp_path):
    import fcntl

    with open(tmp_path / "part", "ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(DatasetError, match=r"/part: another process"):
            ResumingDownloader(tmp_path / "part")(server.url("x"), tmp_path / "out")


@pytest.mark.parametrize("name", ["../outside", "/absolute", "a/../../outside", "C:/windows", "a\\..\\b"])
@pytest.mark.parametrize("kind", ["tgz", "zip"])
def test_members_outside_the_folder_are_refused(tmp_path, name, kind):
    archive = tmp_path / f"evil.{kind}"
    archive.write_bytes((tar_of if kind == "tgz" else zip_of)({"good": b"1", name: b"2"}))
    with pytest.raises(DatasetError, match="outside its folder; "):
        unpack(archive, tmp_path / "deep" / "target")
    assert sorted(file.name for file in tmp_path.rglob("*")) == ["deep", archive.name]


@pytest.mark.parametrize(("kind", "name"), [("tgz", ""), ("tgz", "."), ("zip", ".")])
def test_members_without_a_name_are_refused(tmp_path, kind, name):
    archive = tmp_path / f"odd.{kind}"
    archive.write_bytes((tar_of if kind == "tgz" else zip_of)({"good": b"1", name: b"2"}))
    with pytest.raises(DatasetError, match="not a file name"):
        unpack(archive, tmp_path / "target")
    assert [file.name for file in tmp_path.iterdir()] == [archive.name]


def test_links_are_refused(tmp_path):
    with tarfile.open(tmp_path / "evil.tgz", "w:gz") as archive:
        info = tarfile.TarInfo("link")
        info.type, info.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(info)
    with pytest.raises(DatasetError, match="'link' is a link"):
        unpack(tmp_path / "evil.tgz", tmp_path / "target")
    with zipfile.ZipFile(tmp_path / "evil.zip", "w") as packed:
        link = zipfile.ZipInfo("link")
        link.external_attr = 0o120777 << 16
        packed.writestr(link, "/etc/passwd")
    with pytest.raises(DatasetError, match="'link' is a link"):
        unpack(tmp_path / "evil.zip", tmp_path / "target")


@pytest.mark.parametrize("kind", ["tgz", "zip"])
def test_damaged_archives_leave_nothing(tmp_path, kind, rng):
    whole = (tar_of if kind == "tgz" else zip_of)({"top/x": rng.bytes(100_000)})
    for content in (whole[: len(whole) // 2], b"<html>moved</html>", b""):
        (tmp_path / f"a.{kind}").write_bytes(content)
        with pytest.raises(DatasetError, match=rf"a\.{kind}: is damaged"):
            unpack(tmp_path / f"a.{kind}", tmp_path / "target")
        assert [file.name for file in tmp_path.iterdir()] == [f"a.{kind}"]


def test_the_catalogue_is_complete_and_the_paper_comes_first():
    entries = catalog.list_datasets()
    assert entries[0].name.startswith("freiburg3_long_office")
    assert {entry.kind for entry in entries} == {"tum", "euroc", "kitti", "folder"}
    assert len({entry.name for entry in entries}) == len(entries)
    for entry in entries:
        assert entry.licence.strip()
        assert re.search(r"\d{4}", entry.citation), entry
        assert re.match(r"https?://[\w.-]+/", entry.homepage), entry
        assert bool(entry.urls) != bool(entry.manual)
        assert all(re.match(r"https?://[\w.-]+/\S+$", url) for url in entry.urls), entry
    urls = [url for entry in entries for url in entry.urls]
    assert len(set(urls)) == len(urls)


def test_names_that_are_not_there():
    with pytest.raises(DatasetError, match=r"'freiburg1_dekc'; .* freiburg1_desk\?"):
        catalog.find("freiburg1_dekc")
    with pytest.raises(DatasetError, match=r"/kodak: .* fetch kodak`"):
        catalog.path("kodak")
    with pytest.raises(DatasetError, match=r"(?s)^kitti_odometry: .*image_0"):
        catalog.fetch("kitti_odometry")


def test_fetch_by_name_and_use_in_a_dataset(server, monkeypatch):
    import cv2
    import numpy as np

    from codecbench.plugins.datasets.folder import Folder

    server.files["a.png"] = cv2.imencode(".png", np.zeros((4, 5), np.uint8))[1].tobytes()
    entry = CatalogEntry("pictures", "folder", "", "CC0", "nobody", urls=(server.url("a.png"),))
    monkeypatch.setattr(catalog, "DATASETS", (entry,))
    with pytest.raises(DatasetError, match=r"`.* fetch pictures`"):
        Folder.create(fetched="pictures").open()
    assert catalog.fetch("pictures") == catalog.path("pictures")
    assert Folder.create(fetched="pictures").open().read(0).image.shape == (4, 5)

"""Plugins under `codecbench --confine`: no network, no file outside their folder, and nothing but data comes back."""

from __future__ import annotations

import functools
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from distributions import install_source
from installed_command import Done, Place

from codecbench.core.analysis.collect import open_run
from codecbench.core.contracts.confinement import VARIABLE, confinement, status_inside
from codecbench.core.contracts.errors import CodecbenchError

pytestmark = pytest.mark.thorough

MATRIX = """
version: 1
name: confined
sequences: [{use: folder, name: drawn, params: {path: pictures}}]
codecs: [png, {use: prying, params: {deed: {grid: [DEEDS]}}}]
evaluators: [quality]
run: {workers: 2, timeout_s: 60, executor: EXECUTOR}
"""
PRYING = """
import os, pathlib, signal, socket, sys, tempfile
import numpy as np
from codecbench import NULL_TRACE, Capabilities, Codec, Params, PluginSpec, hookimpl

HOME = pathlib.Path(os.environ["VICTIM"])
try:
    (HOME / "imported").write_text("by whoever imported it")
except OSError:
    pass


ORDER = '[0, {"dict": [["number", 1], ["call", "os:mkdir"], ["with", {"list": ["%s/made"]}]]}]\\n'
OBJECT = '[0, {"record": "subprocess:Popen", "fields": {"args": {"list": ["touch", "%s/called"]}}}]\\n'


def write_everywhere(line):
    for descriptor in range(3, 64):
        try:
            os.write(descriptor, line)
        except OSError:
            continue


class PryingParams(Params):
    deed: str = "none"


class Prying(Codec[PryingParams]):
    name = "prying"
    version = "1"
    params_type = PryingParams
    capabilities = Capabilities(channels=(1, 3), lossless=True)

    def encode(self, image, *, trace=NULL_TRACE):
        getattr(self, "do_" + self.params.deed)()
        return repr(image.shape).encode() + b";" + image.tobytes()

    def decode(self, bitstream, *, trace=NULL_TRACE):
        shape, _, pixels = bitstream.partition(b";")
        return np.frombuffer(pixels, np.uint8).reshape(eval(shape)).copy()

    def do_none(self):
        pathlib.Path("notes").write_text("in its own folder")
        with tempfile.TemporaryDirectory() as folder:
            pathlib.Path(folder, "x").write_text("and among its temporary files")

    def do_home(self):
        (HOME / "written").write_text("mine now")

    def do_network(self):
        socket.create_connection(("127.0.0.1", int(os.environ["PORT"])), 5)

    def do_datagram(self):
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"secret", ("192.0.2.1", 53))

    def do_kill(self):
        os.kill(int(os.environ["BYSTANDER"]), signal.SIGKILL)

    def do_crash(self):
        os.kill(os.getpid(), signal.SIGSEGV)

    def do_exit(self):
        os._exit(3)

    def do_hang(self):
        signal.pause()

    def do_nonsense(self):
        write_everywhere(b"nonsense\\n")

    def do_forge(self):
        write_everywhere((ORDER % HOME).encode())
        write_everywhere((OBJECT % HOME).encode())


@hookimpl
def codecbench_codecs():
    return [PluginSpec("prying", "prying:Prying", "looks around")]
"""
DEEDS = {
    "none": "",
    "home": "OSError: [Errno 30] Read-only file system",
    "network": "[Errno 111] Connection refused",
    "datagram": "OSError: [Errno 101] Network is unreachable",
    "kill": "ProcessLookupError: [Errno 3] No such process",
    "crash": "it ended its process by SIGSEGV",
    "exit": "it ended its process with status 3",
    "nonsense": "it answered nonsense",
    "forge": "it answered nonsense",
}


@functools.cache
def impossible() -> str:
    """Why nothing can be confined here; empty where it can."""
    try:
        confinement()
    except CodecbenchError as error:
        return str(error)
    return ""


@pytest.fixture
def place(tmp_path: Path) -> Place:
    place = Place(tmp_path)
    install_source(place.site, "prying", "1", PRYING)
    (tmp_path / "pictures").mkdir()
    (tmp_path / "victim").mkdir()
    rng = np.random.default_rng(1)
    for number in range(2):
        cv2.imwrite(str(tmp_path / "pictures" / f"{number}.png"), rng.integers(0, 256, (40, 60, 3), np.uint8))
    return place


def run(place: Place, *deeds: str, executor: str = "local", confine: bool = True) -> Done:
    import socket
    import subprocess

    text = MATRIX.replace("DEEDS", ", ".join(deeds)).replace("EXECUTOR", executor)
    (place.folder / "m.yaml").write_text(text)
    bystander = subprocess.Popen(["sleep", "300"])
    with socket.create_server(("127.0.0.1", 0)) as server:
        told = {"PORT": str(server.getsockname()[1]), "BYSTANDER": str(bystander.pid)}
        told["VICTIM"] = str(place.folder / "victim")
        words = [*(["--confine"] if confine else []), "run", "m.yaml", "--out", "out", "--quiet"]
        done = place.call(*words, timeout=300, **told)
    survived = bystander.poll() is None
    bystander.kill()
    bystander.wait()
    assert survived
    assert "Traceback" not in done.output or executor == "dask", done.output  # dask logs tracebacks of its own
    return done


def reasons(place: Place) -> dict[str, tuple[str, str]]:
    """Status and reason of each deed, and of png."""
    found = {}
    for result in open_run(place.folder / "out").results:
        deed = result.cell.codec.params.get("deed", result.cell.codec.name)
        found[str(deed)] = (result.status, result.reason)
    return found


def workers(place: Place) -> dict[str, dict[str, object]]:
    found = {}
    for path in (place.folder / "out" / "records").glob("*/*/record.json"):
        record = json.loads(path.read_text())
        found[record["cell"]["codec"]["params"].get("deed", "png")] = record["worker"]
    return found


@pytest.mark.skipif(bool(impossible()), reason=impossible())
def test_confined_plugins_reach_neither_files_nor_network_nor_processes(place: Place) -> None:
    done = run(place, *DEEDS)
    assert done.status == 1
    found = reasons(place)
    assert found.pop("png") == ("ok", "")
    assert found.pop("none") == ("ok", "")
    for deed, (status, reason) in found.items():
        assert status in ("failed", "crashed"), (deed, reason)
        assert DEEDS[deed] in reason, (deed, reason)
    assert list((place.folder / "victim").iterdir()) == []
    assert not list(place.folder.glob("**/written"))
    told = workers(place)
    assert "confined" not in told["png"]
    assert told["none"]["confined"] == confinement()
    assert set(told["none"]) == {"host", "pid", "confined"}


def test_what_plugins_do_to_their_process_costs_their_rows_unconfined(place: Place) -> None:
    deeds = ("none", "crash", "exit", "nonsense", "forge")
    assert run(place, *deeds, confine=False).status == 1
    found = reasons(place)
    assert (found.pop("png"), found.pop("none")) == (("ok", ""), ("ok", ""))
    assert {deed: DEEDS[deed] in reason for deed, (_, reason) in found.items()} == dict.fromkeys(deeds[1:], True), found
    assert [path.name for path in (place.folder / "victim").iterdir()] == ["imported"]


@pytest.mark.skipif(bool(impossible()), reason=impossible())
def test_listing_imports_plugins_where_they_are_confined(place: Place) -> None:
    victim = place.folder / "victim"
    assert "prying" in place.call("--confine", "list", "codecs", VICTIM=str(victim)).output
    assert list(victim.iterdir()) == []
    assert "prying" in place.call("list", "codecs", VICTIM=str(victim)).output
    assert (victim / "imported").exists(), "what is confined must be seen to be possible"


@pytest.mark.skipif(bool(impossible()), reason=impossible())
def test_a_confined_host_that_hangs_is_given_up_and_its_processes_end(place: Place) -> None:
    text = MATRIX.replace("timeout_s: 60", "timeout_s: 3")
    assert text != MATRIX
    (place.folder / "hang.yaml").write_text(text.replace("DEEDS", "hang").replace("EXECUTOR", "local"))
    done = place.call("--confine", "run", "hang.yaml", "--out", "out", "--quiet", VICTIM=str(place.folder))
    assert done.status == 1
    told = "coding failed: codec prying of prying 1 while encoding: no result within 3 s"
    assert reasons(place)["hang"] == ("timed_out", told)
    mine = [pid for pid in os.listdir("/proc") if pid.isdigit() and str(place.folder).encode() in environment_of(pid)]
    assert mine == []


def environment_of(pid: str) -> bytes:
    try:
        return Path("/proc", pid, "environ").read_bytes()
    except OSError:
        return b""


@pytest.mark.skipif(bool(impossible()), reason=impossible())
def test_confined_results_are_those_of_other_runs(place: Place) -> None:
    assert run(place, "none", confine=False).status == 0
    free = open_run(place.folder / "out").wide
    assert (place.folder / "victim" / "imported").exists(), "what is confined must be seen to be possible"
    (place.folder / "out").rename(place.folder / "free")
    (place.folder / "victim" / "imported").unlink()
    assert run(place, "none").status == 0
    assert open_run(place.folder / "out").wide.equals(free)
    assert list((place.folder / "victim").iterdir()) == []


@pytest.mark.skipif(bool(impossible()), reason=impossible())
def test_plugins_on_dask_workers_are_confined(place: Place) -> None:
    pytest.importorskip("distributed", reason="the extra codecbench[dask] is not installed")
    run(place, "none", "home", executor="dask")
    found = reasons(place)
    assert found["none"] == ("ok", "")
    assert "Read-only file system" in found["home"][1]
    assert list((place.folder / "victim").iterdir()) == []


def test_where_nothing_confines_nothing_runs(place: Place) -> None:
    bare = place.folder / "bin"
    bare.mkdir()
    (place.folder / "m.yaml").write_text(MATRIX.replace("DEEDS", "none").replace("EXECUTOR", "local"))
    done = place.call("--confine", "run", "m.yaml", "--out", "out", PATH=str(bare))
    assert done.status == 3
    assert "plugins cannot be confined on" in done.stderr
    assert "bwrap is not on the PATH" in done.stderr
    assert "leave out --confine" in done.stderr
    refusing = bare / "bwrap"
    refusing.write_text("#!/bin/sh\necho 'bwrap: Creating new namespace failed: Operation not permitted' >&2\nexit 1\n")
    refusing.chmod(0o755)
    done = place.call("list", PATH=str(bare), **{VARIABLE: "1"})
    assert done.status == 3
    assert "the system does not let it: bwrap: Creating new namespace failed: Operation not permitted" in done.stderr
    assert not (place.folder / "out").exists()


def test_the_status_of_a_confined_command() -> None:
    assert [status_inside(status) for status in (0, 1, 86, 139, 137)] == [0, 1, 86, -11, -9]

"""Plugins under `codecbench --confine`: no network, no data, no way from encoder to decoder but the bitstream."""

from __future__ import annotations

import functools
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from distributions import install_source
from installed_command import Done, Place

from codecbench.core.analysis.collect import open_run
from codecbench.core.engine.hosting.confinement import VARIABLE, confinement, paths_in
from codecbench.core.engine.hosting.host import Host, PluginFault

MATRIX = """
version: 1
name: confined
sequences: [{use: mine, name: drawn, params: {path: pictures}}]
codecs: [png, {use: prying, params: {deed: {grid: [DEEDS]}}}]
evaluators: [quality]
run: {workers: 2, timeout_s: 60, executor: EXECUTOR}
"""
PRYING = """
import ctypes, glob, json, os, pathlib, signal, socket, sys, tempfile, time
from contextlib import suppress
import cv2
import numpy as np
from codecbench import (
    NULL_TRACE, Capabilities, Codec, Dataset, Frame, FrameSequence, Params, PathParam, PluginSpec, hookimpl
)

HOME = pathlib.Path(os.environ["VICTIM"])
with suppress(OSError):
    (HOME / "imported").write_text("by whoever imported it")
ORDER = '[0, {"dict": [["number", 1], ["call", "os:mkdir"], ["with", {"list": ["%s/made"]}]]}]\\n'
OBJECT = '[0, {"record": "subprocess:Popen", "fields": {"args": {"list": ["touch", "%s/called"]}}}]\\n'
SECRET = b"what was encoded"
libc = ctypes.CDLL(None, use_errno=True)


def daemon():
    with suppress(OSError):
        (HOME / "daemon").write_text("runs")
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            time.sleep(300)
        os._exit(0)
    os.wait()


def succeed(status):
    if status < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return status


if os.environ.get("DAEMON"):
    daemon()


def write_everywhere(line):
    for descriptor in range(3, 64):
        with suppress(OSError):
            os.write(descriptor, line)


class PryingParams(Params):
    deed: str = "none"


class Prying(Codec[PryingParams]):
    name = "prying"
    version = "1"
    params_type = PryingParams
    capabilities = Capabilities(channels=(1, 3), lossless=True)

    def encode(self, image, *, trace=NULL_TRACE):
        told = getattr(self, "do_" + self.params.deed)() or ()
        return json.dumps([image.shape, told]).encode() + b";" + image.tobytes()

    def decode(self, bitstream, *, trace=NULL_TRACE):
        facts, _, pixels = bitstream.partition(b";")
        shape, told = json.loads(facts)
        getattr(self, "undo_" + self.params.deed, lambda *_: None)(*told)
        return np.frombuffer(pixels, np.uint8).reshape(shape).copy()

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

    def do_frame(self):
        (HOME.parent / "pictures" / "0.png").read_bytes()

    def do_run(self):
        os.listdir(HOME.parent / "out")

    def undo_frame(self):
        self.do_frame()

    def do_sysctl(self):
        open("/proc/sys/kernel/core_pattern", "w")

    def do_package(self):
        open(__file__, "a")

    def do_mount(self):
        succeed(libc.mount(b"none", b"/tmp", b"tmpfs", 0, None))

    def do_namespace(self):
        succeed(libc.unshare(0x10000000))

    def do_root(self):
        os.listdir("/proc/1/root")

    def do_trace(self):
        succeed(libc.ptrace(16, 1, None, None))

    def do_parent(self):
        for number in (signal.SIGTERM, signal.SIGKILL, signal.SIGINT):
            os.kill(os.getppid(), number)
        daemon()

    def do_daemon(self):
        daemon()

    def do_deep(self):
        for _ in range(1500):
            os.mkdir("deep")
            os.chdir("deep")

    def do_link(self):
        os.remove("crash")
        os.symlink("/etc/hostname", "crash")
        os._exit(4)

    def do_look(self):
        status = dict(line.split(":", 1) for line in open("/proc/self/status"))
        assert status["Uid"].split() == status["Gid"].split() == ["65534"] * 4, status
        sets = [int(status[name], 16) for name in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")]
        assert (sets, status["NoNewPrivs"].strip(), status["Groups"].strip()) == ([0] * 5, "1", ""), status
        processes = [int(name) for name in os.listdir("/proc") if name.isdigit()]
        assert processes == [1, os.getpid()], processes
        names = [os.readlink(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd")
                 if os.path.lexists(f"/proc/self/fd/{name}")]
        own = ("pipe:", "/memfd:codecbench", "/dev/null", os.getcwd() + "/")
        assert not [name for name in names if not name.startswith(own)], names
        with suppress(OSError):
            raise AssertionError(socket.socket(40, socket.SOCK_STREAM))  # that of virtual machines
        assert not glob.glob("/home/*") + glob.glob("/run/*") + glob.glob("/var/*"), os.listdir("/")
        known = (os.environ["PLACE"], os.getcwd(), sys.prefix)  # of an environment among the temporary files
        assert not [path for path in glob.glob("/tmp/*") if not any(name.startswith(path) for name in known)]

    def do_leave(self):
        for folder in ("/tmp", "/dev/shm", "/var/tmp", os.getcwd(), os.path.expanduser("~"), str(HOME)):
            with suppress(OSError):
                pathlib.Path(folder, "codecbench-left").write_bytes(SECRET)
        return [os.getcwd()]

    def undo_leave(self, folder):
        found = []
        for place in ("/tmp", "/dev/shm", "/var/tmp", folder, os.path.expanduser("~"), str(HOME)):
            found += glob.glob(place + "/codecbench-left")
        assert not found, " ".join(found)


class MineParams(Params):
    path: PathParam


class Mine(Dataset[MineParams]):
    name = "mine"
    version = "1"
    params_type = MineParams

    def open(self):
        return Pictures(self.params.path)


class Pictures(FrameSequence):
    def __init__(self, folder):
        self.files = sorted(folder.glob("*.png"))
        self.name, self.channels, self.camera, self.ground_truth = "pictures", 3, None, None
        self.timestamps_s, self.frame_rate_hz = np.arange(len(self.files)) / 30.0, 30.0
        self.fingerprint = "pictures-of-mine"
        with suppress(OSError):
            (folder / "written").write_text("by the dataset")

    def read(self, index):
        return Frame(index, index / 30.0, cv2.imread(str(self.files[index])))


@hookimpl
def codecbench_codecs():
    return [PluginSpec("prying", "prying:Prying", "looks around")]


@hookimpl
def codecbench_datasets():
    return [PluginSpec("mine", "prying:Mine", "pictures")]
"""
ABSENT = "[Errno 2] No such file or directory"
READ_ONLY = "[Errno 30] Read-only file system"
DEEDS = {
    "none": "",
    "look": "",
    "parent": "",
    "leave": "",
    "daemon": "",
    "deep": "",
    "home": ABSENT,
    "network": "[Errno 111] Connection refused",
    "datagram": "OSError: [Errno 101] Network is unreachable",
    "kill": "ProcessLookupError: [Errno 3] No such process",
    "crash": "its process was killed by SIGSEGV",
    "exit": "its process exited with status 3",
    "link": "its process exited with status 4",
    "nonsense": "it sent an invalid answer",
    "forge": "it sent an invalid answer",
    "frame": ABSENT,
    "run": ABSENT,
    "sysctl": READ_ONLY,
    "package": "[Errno 13] Permission denied" if os.geteuid() == 0 else READ_ONLY,
    "mount": "[Errno 1] Operation not permitted",
    "namespace": "[Errno 28] No space left on device",
    "root": "[Errno 13] Permission denied",
    "trace": "[Errno 1] Operation not permitted",
}
FREE_FOR_ALL = ("home", "frame", "run", "network", "leave", "package")
"""Deeds that succeed where nothing is confined, or that find what they left."""


@functools.cache
def impossible() -> str:
    """Why nothing can be confined here, by the system's own command, for codecbench may fail where it need not."""
    words = ["unshare", "--user", "--map-root-user", "--mount", "--net", "--ipc", "--uts", "--pid", "--fork",
             "--mount-proc", "true"]  # fmt: skip
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return "no `unshare` (util-linux) to find out whether namespaces can be made here"
    return f"namespaces cannot be made here: {done.stderr.strip()}" if done.returncode else ""


confines = pytest.mark.skipif(bool(impossible()), reason=impossible())


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
    text = MATRIX.replace("DEEDS", ", ".join(deeds)).replace("EXECUTOR", executor)
    (place.folder / "m.yaml").write_text(text)
    bystander = subprocess.Popen(["sleep", "300"])
    with socket.create_server(("127.0.0.1", 0)) as server:
        told = {"PORT": str(server.getsockname()[1]), "BYSTANDER": str(bystander.pid)}
        told |= {"VICTIM": str(place.folder / "victim"), "PLACE": str(place.folder)}
        words = [*(["--confine"] if confine else []), "run", "m.yaml", "--out", "out", "--quiet"]
        done = place.call(*words, timeout=300, **told)
    survived = bystander.poll() is None
    bystander.kill()
    bystander.wait()
    assert survived
    assert left_running(place) == []
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


def call_anew(place: Place, *words: str, **variables: str) -> Done:
    """Call the command where nothing is remembered of what plugins offer."""
    with tempfile.TemporaryDirectory(dir=place.folder) as cache:
        return place.call(*words, CODECBENCH_CACHE=cache, **variables)


def left_running(place: Place) -> list[str]:
    """Processes with this place in their environment."""

    def environment_of(pid: str) -> bytes:
        try:
            return Path("/proc", pid, "environ").read_bytes()
        except OSError:
            return b""

    return [pid for pid in os.listdir("/proc") if pid.isdigit() and str(place.folder).encode() in environment_of(pid)]


@confines
def test_a_confined_host_sees_what_it_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "1")
    host, data = Host("mine 1"), tmp_path / "data"
    data.mkdir()
    (data / "a file").write_text("words")
    try:
        assert host.ask("os:getuid") == 65534
        with pytest.raises(PluginFault, match="No such file"):
            host.ask("os:listdir", str(data))
        assert host.ask("os:listdir", str(data), shows=[str(data)]) == ["a file"]
        with pytest.raises(PluginFault, match="Read-only"):
            host.ask("os:mkdir", str(data / "new"), shows=[str(data)])
    finally:
        host.end()


NEIGHBORS = """
import ctypes, fcntl, os, socket, sys
from multiprocessing import shared_memory

libc = ctypes.CDLL(None, use_errno=True)
ADD_KEY, KEYCTL = {"x86_64": (248, 250)}.get(os.uname().machine, (217, 219))
left = []


def leave(name):
    left.append(socket.socket(socket.AF_UNIX))
    left[0].bind(chr(0) + name)
    left[0].listen()
    libc.shmget(0xC0DEC, 4096, 0o1666)
    left.append(shared_memory.SharedMemory(name, create=True, size=10))
    key = libc.syscall(ADD_KEY, b"user", name.encode(), b"words", 5, -3)
    libc.syscall(KEYCTL, 5, key, 0x3F3F3F3F)
    left.append(open(os.__file__))
    fcntl.flock(left[-1], fcntl.LOCK_EX)
    return os.getcwd(), key


def find(name, folder, key):
    found = ["folder"] * os.path.exists(folder)
    for way, look in {
        "socket": lambda: socket.socket(socket.AF_UNIX).connect(chr(0) + name),
        "shm": lambda: shared_memory.SharedMemory(name),
        "process": lambda: [pid for pid in os.listdir("/proc") if pid.isdigit() and int(pid) > 2][0],
    }.items():
        try:
            look()
            found.append(way)
        except (OSError, IndexError):
            pass
    memory = libc.shmget(0xC0DEC, 4096, 0o666)
    if memory >= 0:
        found.append("sysv")
        libc.shmctl(memory, 0, None)
    if libc.syscall(KEYCTL, 11, key, ctypes.create_string_buffer(100), 100) >= 0:
        found.append("key")
    try:
        fcntl.flock(open(os.__file__), fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        found.append("lock")
    return found
"""


@confines
@pytest.mark.thorough
@pytest.mark.parametrize("confined", ["0", "1"])
def test_confined_hosts_find_nothing_of_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, confined: str
) -> None:
    (tmp_path / "neighbors.py").write_text(NEIGHBORS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(VARIABLE, confined)
    encodes, decodes = Host("mine 1", "encode"), Host("mine 1", "decode")
    try:
        name = f"codecbench-{os.getpid()}"
        folder, key = encodes.ask("neighbors:leave", name)
        found = decodes.ask("neighbors:find", name, folder, key)
    finally:
        encodes.end()
        decodes.end()
    everything = {"folder", "socket", "shm", "process", "sysv", "key", "lock"}
    assert set(found) == (set() if confined == "1" else everything if key >= 0 else everything - {"key"})


def test_paths_that_a_question_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pictures").mkdir()
    monkeypatch.setenv("SOMEWHERE", str(tmp_path))
    named = {str(tmp_path / "pictures")}
    values = {"path": "pictures", "more": [{"of": "${SOMEWHERE}/pictures"}], "rate": 3, "other": "absent", "no": ""}
    assert paths_in(["dataset", "mine", values, str(tmp_path)]) == named
    assert paths_in(["mine", {"path": str(tmp_path / "pictures")}]) == named
    assert paths_in(["mine", str(tmp_path)]) == {str(tmp_path)}
    assert paths_in(["mine", {"path": "tests"}]) == set()


@confines
@pytest.mark.thorough
def test_confined_plugins_reach_neither_files_nor_network_nor_processes(place: Place) -> None:
    done = run(place, *DEEDS)
    assert done.status == 1
    found = reasons(place)
    assert found.pop("png") == ("ok", "")
    for deed, (status, reason) in found.items():
        assert (status in ("failed", "crashed")) == bool(DEEDS[deed]), (deed, status, reason)
        assert DEEDS[deed] in reason, (deed, reason)
    assert list((place.folder / "victim").iterdir()) == []
    assert not list(place.folder.glob("**/written"))
    told = workers(place)
    assert told["none"]["confined"] == confinement() == "namespaces, user 65534"
    assert set(told["none"]) == {"host", "pid", "confined"}
    hostname = Path("/etc/hostname").read_text().strip()
    traces = [path.read_text() for path in (place.folder / "out").glob("**/*") if path.suffix in (".txt", ".log")]
    assert not [trace for trace in traces if hostname and f"in its host:\n{hostname}" in trace]


@pytest.mark.thorough
def test_those_deeds_succeed_unconfined(place: Place) -> None:
    run(place, *FREE_FOR_ALL, confine=False)
    found = reasons(place)
    assert {deed for deed, (status, _) in found.items() if status == "ok"} == {"png", *FREE_FOR_ALL} - {"leave"}, found
    ways = ("/tmp/", "/dev/shm/", "/var/tmp/", "victim/")
    assert [way for way in ways if way not in found["leave"][1]] == [], found["leave"]


@pytest.mark.thorough
def test_what_plugins_do_to_their_process_costs_their_rows_unconfined(place: Place) -> None:
    deeds = ("none", "daemon", "crash", "exit", "nonsense", "forge", "parent")
    assert run(place, *deeds, confine=False).status == 1
    found = reasons(place)
    assert [found.pop(deed) for deed in ("png", "none", "daemon")] == [("ok", "")] * 3
    del found["parent"]  # it may end its supervisor, and leaves nothing running all the same
    assert {deed: DEEDS[deed] in reason for deed, (_, reason) in found.items()} == dict.fromkeys(deeds[2:-1], True), (
        found
    )
    assert {path.name for path in (place.folder / "victim").iterdir()} == {"imported", "daemon"}


@confines
@pytest.mark.thorough
@pytest.mark.parametrize("words", [["list", "codecs"], ["--confine", "list", "codecs"]], ids=" ".join)
def test_what_a_plugin_starts_while_it_is_described_ends(place: Place, words: list[str]) -> None:
    assert "prying" in call_anew(place, *words, VICTIM=str(place.folder), DAEMON="1").output
    assert left_running(place) == []
    assert (place.folder / "daemon").exists() == ("--confine" not in words)


@confines
@pytest.mark.thorough
def test_listing_imports_plugins_where_they_are_confined(place: Place) -> None:
    victim = place.folder / "victim"
    assert "prying" in call_anew(place, "--confine", "list", "codecs", VICTIM=str(victim)).output
    assert list(victim.iterdir()) == []
    assert "prying" in call_anew(place, "list", "codecs", VICTIM=str(victim)).output
    assert (victim / "imported").exists(), "what is confined must be seen to be possible"


@confines
@pytest.mark.thorough
def test_a_confined_host_that_hangs_is_given_up_and_its_processes_end(place: Place) -> None:
    text = MATRIX.replace("timeout_s: 60", "timeout_s: 3")
    assert text != MATRIX
    (place.folder / "hang.yaml").write_text(text.replace("DEEDS", "hang").replace("EXECUTOR", "local"))
    done = place.call("--confine", "run", "hang.yaml", "--out", "out", "--quiet", VICTIM=str(place.folder))
    assert done.status == 1
    status, reason = reasons(place)["hang"]
    assert status == "timed_out"
    assert reason.endswith("codec prying of prying 1 while encoding: no result within 3 s")
    assert left_running(place) == []


@confines
@pytest.mark.thorough
def test_confined_results_are_those_of_other_runs(place: Place) -> None:
    assert run(place, "none", confine=False).status == 0
    free = open_run(place.folder / "out").wide
    assert (place.folder / "victim" / "imported").exists(), "what is confined must be seen to be possible"
    (place.folder / "out").rename(place.folder / "free")
    (place.folder / "victim" / "imported").unlink()
    assert run(place, "none").status == 0
    assert open_run(place.folder / "out").wide.equals(free)
    assert list((place.folder / "victim").iterdir()) == []


@confines
@pytest.mark.thorough
def test_plugins_on_dask_workers_are_confined(place: Place) -> None:
    pytest.importorskip("distributed", reason="the extra codecbench[dask] is not installed")
    run(place, "none", "home", executor="dask")
    found = reasons(place)
    assert found["none"] == ("ok", "")
    assert ABSENT in found["home"][1]
    assert list((place.folder / "victim").iterdir()) == []


@confines
@pytest.mark.thorough
def test_where_nothing_confines_nothing_runs(place: Place) -> None:
    (place.folder / "m.yaml").write_text(MATRIX.replace("DEEDS", "none").replace("EXECUTOR", "local"))
    words = [sys.executable, "-c", FORBIDDING, "--confine", "run", "m.yaml", "--out", "out"]
    done = subprocess.run(words, cwd=place.folder, env=place.environment(), capture_output=True, text=True, timeout=100)
    assert done.returncode == 3, done.stderr
    assert "cannot be confined" in done.stderr
    assert re.search(r"\[Errno 28\] [\w ]+: 'unshare", done.stderr)
    assert ".max_user_namespaces" in done.stderr
    assert "leave out --confine" in done.stderr
    assert not (place.folder / "out").exists()


FORBIDDING = """
import ctypes, os, sys
own = os.geteuid(), os.getegid()
assert ctypes.CDLL(None).unshare(0x10000000) == 0
for name, text in (("setgroups", "deny"), ("uid_map", f"0 {own[0]} 1"), ("gid_map", f"0 {own[1]} 1")):
    with open(f"/proc/self/{name}", "w") as file:
        file.write(text)
with open("/proc/sys/user/max_user_namespaces", "w") as file:
    file.write("0")
sys.argv[0] = "codecbench"
from codecbench.__main__ import main
sys.exit(main())
"""


LOADS = "import subprocess, sys, codecbench; subprocess.run([sys.executable, '-c', ''], check=True)"


@confines
@pytest.mark.thorough
@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_users_without_privileges_confine_too() -> None:
    user = 1000
    script = "from codecbench.core.engine.hosting.host import Host; host = Host('mine 1'); print(host.ask('os:getuid'))"
    words = ["setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups", sys.executable, "-c"]
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:  # which all may enter, unlike tmp_path
        os.chown(folder, user, user)
        there = {**os.environ, VARIABLE: "1", "TMPDIR": folder, "HOME": folder}
        if subprocess.run([*words, LOADS], env=there, check=False, capture_output=True).returncode != 0:
            pytest.skip(f"user {user} cannot read {os.path.realpath(sys.executable)} or what it imports")
        done = subprocess.run([*words, script], env=there, capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "65534\n", done.stderr


@confines
@pytest.mark.thorough
def test_a_host_that_is_killed_ends_all_that_it_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "1")
    host = Host("mine 1")
    host.ask("os:getpid")
    assert host._process is not None
    inside = Path(f"/proc/{host._process.pid}/task/{host._process.pid}/children").read_text().split()
    os.kill(host._process.pid, signal.SIGKILL)
    host.end()
    for _ in range(100):
        if not any(Path("/proc", pid).exists() for pid in inside):
            return
        signal.sigtimedwait([], 0.02)
    pytest.fail(f"{inside} of a supervisor that was killed")

"""The program that supervises a host: it starts it, waits for it, and kills all processes that it leaves behind.

It also confines the host, on Linux and if asked: in namespaces of its own, as an unprivileged user, in a file system
with little more than installed packages. All of that happens before a plugin can run, so nothing else of codecbench is
imported here.
"""

from __future__ import annotations

import ctypes
import errno
import importlib
import json
import os
import signal
import struct
import sys
from contextlib import suppress
from typing import Any, Final, NoReturn

USER: Final = 65534
"""User and group id of confined hosts: nobody."""

_SYSTEM: Final = (
    "/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/nix/store", "/etc/alternatives", "/etc/ld.so.cache",
    "/etc/ld.so.conf", "/etc/ld.so.conf.d", "/etc/localtime", *(f"/dev/{name}" for name in (
        "null", "zero", "full", "random", "urandom")),
)  # fmt: skip
_IMPORTABLE: Final = (".py", ".so", ".egg-info", "__pycache__")
_libc = ctypes.CDLL(None, use_errno=True)

# Of Linux' headers. System calls have these numbers on x86-64 and on all architectures that came after it.
_CLONE_NEW: Final = 0x10000000 | 0x20000 | 0x20000000 | 0x40000000 | 0x8000000 | 0x4000000
"""New namespaces: user, mounts, processes, network, IPC and host name."""
_OPEN_TREE, _MOVE_MOUNT, _MOUNT_SETATTR = 428, 429, 442
_OF_MACHINE: Final = ("pivot_root", "socket", "flock", "fcntl", "keyctl", "request_key", "add_key", "inotify_init",
                      "inotify_init1", "fanotify_init", "perf_event_open", "syslog")  # fmt: skip
_LATER: Final = (41, 198, 32, 25, 219, 218, 217, 26, 26, 262, 241, 116)
_MACHINES: Final = {
    "x86_64": (0xC000003E, (155, 41, 73, 72, 250, 249, 248, 253, 294, 300, 298, 103)),
    "aarch64": (0xC00000B7, _LATER),
    "riscv64": (0xC00000F3, _LATER),
}
"""Audit architecture of each machine, and its system call numbers in the order of `_OF_MACHINE`."""
_REFUSED: Final = (425, 451)
"""io_uring_setup, which no filter sees through, and cachestat."""
_SET_LOCK, _NOTIFY = (6, 7, 37, 38), (1024, 1026)
"""Commands of fcntl."""
_FAMILIES: Final = (1, 2, 10, 16)
"""Socket families that namespaces isolate: Unix, IPv4, IPv6 and netlink."""
_AT_FDCWD: Final = -100
_AT_EMPTY_PATH, _AT_RECURSIVE, _CLOEXEC = 0x1000, 0x8000, os.O_CLOEXEC
_READ_ONLY, _NOSUID, _NODEV, _NOEXEC = 1, 2, 4, 8
"""Flags of mount and of mount_setattr, which agree on them."""
_MS_PRIVATE_ALL, _MNT_DETACH = 0x44000, 2
_PDEATHSIG, _DUMPABLE, _CAPBSET_DROP, _CHILD_SUBREAPER, _NO_NEW_PRIVS = 1, 4, 24, 36, 38
_SECCOMP, _FILTER = 22, 2
_LOAD, _IF_EQUAL, _IF_LARGE, _RETURN = 0x20, 0x15, 0x35, 0x06
_ALLOW, _ERROR = 0x7FFF0000, 0x50000
_CAPABILITIES_VERSION: Final = 0x20080522
_SIOCSIFFLAGS, _IFF_UP = 0x8914, 1


def main(request: str) -> NoReturn:
    """Supervise a host, and exit as it does: with its status, or 128 plus the number of the signal that ended it.

    request: a JSON list of these items.

        paths          `sys.path` of the host
        dies           whether it ends with the thread that started this
        shows          paths that it sees if it is confined, otherwise None
        descriptors    its own descriptors
        folder         its folder
        function       the function `module:name` that it calls
        arguments      arguments of that function
    """
    paths, dies, shows, descriptors, folder, function, arguments = json.loads(request)
    if sys.platform == "linux":
        _prctl(_CHILD_SUBREAPER, 1)
        if dies:
            _prctl(_PDEATHSIG, signal.SIGTERM)
    (unshared, unshares), (mapped, maps) = os.pipe(), os.pipe()
    if host := os.fork():
        signal.signal(signal.SIGTERM, lambda *_: _kill_children(host))
        _close(*descriptors, unshares, mapped)
        if shows is not None:
            os.read(unshared, 1)
            _map_ids(host, folder, maps)
        _close(maps)
        status = _status(host)
        while True:
            _kill_children(host)
            try:
                os.waitpid(-1, 0)
            except ChildProcessError:
                os._exit(status)
    _close(unshared, maps)
    if shows is not None:
        _confine(_sources(paths, shows), folder, descriptors, unshares, mapped)
    _close(unshares, mapped)
    os.setpgid(0, 0)
    sys.path[:] = paths
    module, _, name = function.partition(":")
    getattr(importlib.import_module(module), name)(*arguments)
    os._exit(0)


def _status(child: int) -> int:
    """Wait for a child and return its status; meanwhile reap orphans, which become this process's children."""
    while True:
        pid, waited = os.waitpid(-1, 0)
        if pid == child:
            status = os.waitstatus_to_exitcode(waited)
            return status if status >= 0 else 128 - status


def _kill_children(host: int) -> None:
    """Kill all children. Their children become this process's, so repeated calls reach all descendants.

    host: process group to kill if the children cannot be listed.
    """
    if sys.platform != "linux":
        with suppress(OSError):
            os.killpg(host, signal.SIGKILL)
        return
    try:
        with open(f"/proc/self/task/{os.getpid()}/children") as file:
            pids = [int(pid) for pid in file.read().split()]
    except OSError:  # this system does not list them
        pids = [int(pid) for pid in os.listdir("/proc") if pid.isdigit() and _parent(pid) == os.getpid()]
    for pid in pids:
        with suppress(OSError):
            os.kill(pid, signal.SIGKILL)


def _parent(pid: str) -> int:
    with suppress(OSError), open(f"/proc/{pid}/stat", errors="replace") as file:
        return int(file.read().rpartition(")")[2].split()[1])
    return 0


def _map_ids(pid: int, folder: str, maps: int) -> None:
    """Map user and group ids of a process in the user namespace that it has made; write an error to `maps`.

    For root all ids are kept for a while, because it uses its privileges to mount what only root may read.
    """
    try:
        if os.geteuid() == 0:
            os.chown(folder, USER, USER)
        else:
            _write(f"/proc/{pid}/setgroups", "deny")
        for kind, outer_id in (("uid", os.geteuid()), ("gid", os.getegid())):
            ranges = [f"{USER} {outer_id} 1"]
            if os.geteuid() == 0:
                with open(f"/proc/self/{kind}_map") as file:
                    ranges = [f"{first} {first} {count}" for first, _, count in map(str.split, file)]
            _write(f"/proc/{pid}/{kind}_map", "\n".join(ranges))
    except OSError as error:
        with suppress(BrokenPipeError):
            os.write(maps, str(error).encode())


def _write(path: str, text: str) -> None:
    """Write in a single call, as the files of /proc require."""
    with open(path, "wb", buffering=0) as file:
        file.write(text.encode())


def _sources(paths: list[str], shows: list[str]) -> list[str]:
    """Return what a confined host sees, read-only: files of system and interpreter, its imports, and `shows`."""
    paths_shown = {*_SYSTEM, *shows, sys.prefix, sys.base_prefix, sys.executable}
    paths_shown.update(filter(None, os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)))
    for path in paths:
        names: list[str] = []
        with suppress(OSError):  # it is an archive or missing
            names = os.listdir(path)
        if not names or any(name.endswith(".dist-info") for name in names):
            paths_shown.add(path)
        else:  # a project's folder, which may also hold its data
            inside = [os.path.join(path, name) for name in names]
            paths_shown.update(
                path_inside
                for path_inside in inside
                if path_inside.endswith(_IMPORTABLE) or os.path.exists(f"{path_inside}/__init__.py")
            )
    outermost: list[str] = []
    for path in sorted({*map(os.path.abspath, paths_shown), *map(os.path.realpath, paths_shown)} - {"/"}):
        if os.path.exists(path) and not any(path.startswith(f"{upper}/") for upper in outermost):
            outermost.append(path)
    return outermost


def _confine(sources: list[str], folder: str, descriptors: list[int], unshares: int, mapped: int) -> None:
    """Continue as the only child of the first process of new namespaces; everything in them ends with that process."""
    try:
        _call("unshare", _CLONE_NEW)
        _prctl(_PDEATHSIG, signal.SIGKILL)
        os.close(unshares)
        if failure := os.read(mapped, 1000).decode():
            raise OSError(failure)
        if first := os.fork():
            _close(*descriptors)
            os._exit(_status(first))
        _build_root(sources, folder)
        _give_up_privileges()
    except OSError as error:
        print(error, file=sys.stderr, flush=True)  # noqa: T201 - `confinement.confinement` reads it
        os._exit(1)
    host = os.fork()
    _prctl(_DUMPABLE, not host)  # the host may read its own /proc entry, but not trace its parent
    if host:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        _close(*descriptors)
        os._exit(_status(host))


def _build_root(sources: list[str], folder: str) -> None:
    """Make a file system of these paths and the host's folder. Only that, an empty /tmp and /dev/shm are writable.

    Needs the privileges of the namespaces' first process.
    """
    mask = os.umask(0o022)
    _call("mount", None, b"/", None, _MS_PRIVATE_ALL, None)
    own_tree = _tree(folder, _NOSUID | _NODEV)
    _mount("tmpfs", folder, _NOSUID | _NODEV, "mode=755,size=16m")  # the new root, until all is in it
    for path, size in (("/tmp", "256m"), ("/dev/shm", "50%")):
        os.makedirs(folder + path)
        _mount("tmpfs", folder + path, _NOSUID | _NODEV, f"mode=1777,size={size}")
    for path in sources:
        is_device = path.startswith("/dev/")
        _attach(_tree(path, _READ_ONLY | _NOSUID | (0 if is_device else _NODEV)), path, folder)
    _attach(own_tree, folder, folder)
    with suppress(OSError):  # this system has no such limit
        _write("/proc/sys/user/max_user_namespaces", "0")
    os.mkdir(f"{folder}/proc")
    _mount("proc", f"{folder}/proc", _READ_ONLY | _NOSUID | _NODEV | _NOEXEC)
    os.symlink("/proc/self/fd", f"{folder}/dev/fd")
    os.chdir(folder)
    _call("syscall", _machine()[1]["pivot_root"], b".", b".")
    _call("umount2", b".", _MNT_DETACH)
    os.chdir("/")
    _set_attributes(_AT_FDCWD, "/", 0, _READ_ONLY | _NOSUID | _NODEV)
    os.chdir(folder)
    os.umask(mask)


def _tree(path: str, attributes: int) -> int:
    """Return a descriptor of a copy of the mounts at a path, with these attributes."""
    tree = _call("syscall", _OPEN_TREE, _AT_FDCWD, os.fsencode(path), 1 | _CLOEXEC | _AT_RECURSIVE)
    _set_attributes(tree, "", _AT_EMPTY_PATH | _AT_RECURSIVE, attributes)
    return tree


def _set_attributes(descriptor: int, path: str, flags: int, attributes: int) -> None:
    values = (ctypes.c_uint64 * 4)(attributes)
    _call("syscall", _MOUNT_SETATTR, descriptor, path.encode(), flags, ctypes.byref(values), ctypes.sizeof(values))


def _attach(tree: int, path: str, root: str) -> None:
    """Mount a tree at a path below the new root."""
    place = root + path
    if os.path.isdir(path) and not os.path.exists(place):
        os.makedirs(place)
    elif not os.path.exists(place):
        os.makedirs(os.path.dirname(place), exist_ok=True)
        os.close(os.open(place, os.O_CREAT))
    _call("syscall", _MOVE_MOUNT, tree, b"", _AT_FDCWD, os.fsencode(place), 4)
    os.close(tree)


def _mount(kind: str, place: str, flags: int, options: str = "") -> None:
    _call("mount", kind.encode(), os.fsencode(place), kind.encode(), flags, options.encode())


def _give_up_privileges() -> None:
    """Become nobody, without capabilities or a way to get any, and without the user's keys."""
    _start_loopback()
    with suppress(OSError):  # this system has no keys
        _call("syscall", _machine()[1]["keyctl"], 1, None)
    with suppress(OSError):  # capability numbers end somewhere below 64
        for capability in range(64):
            _prctl(_CAPBSET_DROP, capability)
    if os.geteuid() != USER:
        os.setgroups([])
        os.setresgid(USER, USER, USER)
        os.setresuid(USER, USER, USER)
    _call("capset", ctypes.byref((ctypes.c_uint32 * 2)(_CAPABILITIES_VERSION)), ctypes.byref((ctypes.c_uint32 * 6)()))
    _prctl(_NO_NEW_PRIVS, 1)
    _filter_calls()
    _prctl(_PDEATHSIG, signal.SIGKILL)


def _filter_calls() -> None:
    """Refuse system calls through which hosts could communicate despite namespaces: keys, sockets, others' files.

    A lock appears to be granted but is not taken: nobody else can lock a host's own files.
    """
    architecture, numbers = _machine()

    def refuse(number: int, error: int) -> list[tuple[int, ...]]:
        return [(_IF_EQUAL, 0, 1, number), (_RETURN, 0, 0, _ERROR | error)]

    def look(call: str, argument: int, *rules: tuple[int, ...]) -> list[tuple[int, ...]]:
        return [(_IF_EQUAL, 0, len(rules) + 1, numbers[call]), (_LOAD, 0, 0, 16 + 8 * argument), *rules]

    rules: list[tuple[int, ...]] = [
        (_LOAD, 0, 0, 4),
        (_IF_EQUAL, 1, 0, architecture),
        (_RETURN, 0, 0, _ERROR | errno.ENOSYS),
    ]
    rules += [(_LOAD, 0, 0, 0), (_IF_LARGE, 0, 1, 0x40000000), (_RETURN, 0, 0, _ERROR | errno.ENOSYS)]  # the x32 ABI
    for number in (*(numbers[call] for call in _OF_MACHINE[4:]), *_REFUSED):
        rules += refuse(number, errno.ENOSYS)
    rules += refuse(numbers["flock"], 0)
    locks = [rule for command in _SET_LOCK for rule in refuse(command, 0)]
    notifications = [rule for command in _NOTIFY for rule in refuse(command, errno.EINVAL)]
    rules += look("fcntl", 1, *locks, *notifications, (_RETURN, 0, 0, _ALLOW))
    families = [(_IF_EQUAL, len(_FAMILIES) - place, 0, family) for place, family in enumerate(_FAMILIES)]
    rules += look("socket", 0, *families, (_RETURN, 0, 0, _ERROR | errno.EAFNOSUPPORT), (_RETURN, 0, 0, _ALLOW))
    rules.append((_RETURN, 0, 0, _ALLOW))
    program = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *rule) for rule in rules))
    _call("prctl", _SECCOMP, _FILTER, struct.pack("@HP", len(rules), ctypes.addressof(program)))


def _machine() -> tuple[int, dict[str, int]]:
    """Return this machine's architecture and system call numbers. Raises OSError if they are unknown."""
    name = os.uname().machine
    if name not in _MACHINES:
        raise OSError(f"its architecture {name} is not one of {', '.join(_MACHINES)}")
    architecture, numbers = _MACHINES[name]
    return architecture, dict(zip(_OF_MACHINE, numbers, strict=True))


def _start_loopback() -> None:
    import fcntl  # here, because unconfined hosts do not need them
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, _SIOCSIFFLAGS, b"lo".ljust(16, b"\0") + _IFF_UP.to_bytes(24, sys.byteorder))


def _prctl(option: int, value: int) -> None:
    _call("prctl", option, value, 0, 0, 0)


def _call(name: str, *arguments: Any) -> int:
    """Call a C function. Raises OSError that names it."""
    plain = [ctypes.c_long(value) if isinstance(value, int) else value for value in arguments]
    result: int = getattr(_libc, name)(*plain)
    if result == -1:
        number = ctypes.get_errno()
        raise OSError(
            number, os.strerror(number), " ".join([name, *(str(argument) for argument in arguments if argument)])
        )
    return result


def _close(*descriptors: int) -> None:
    for descriptor in descriptors:
        with suppress(OSError):
            os.close(descriptor)


if __name__ == "__main__":
    main(sys.argv[1])

"""Distributions that misbehave as soon as their entry point is imported: their source, and what is said of them.

Those of which nothing is said offer a codec called as they are.
"""

from __future__ import annotations

from codecbench_zoo.cases import ENDED, NO_ANSWER, NONSENSE

OFFER = """
from codecbench import PluginSpec, hookimpl

@hookimpl
def codecbench_codecs():
    return [PluginSpec("NAME", "codecbench_zoo.lingering:Innocent", "offered")]
"""
_SPECS = """
from codecbench import PluginSpec, hookimpl

@hookimpl
def codecbench_codecs():
    return """

DOORS: dict[str, tuple[str, str]] = {
    "exits": ("import sys\nsys.exit(0)", "SystemExit: 0"),
    "leaves": ("import os\nos._exit(0)", ENDED + "exited with status 0"),
    "raises": ("raise RuntimeError('\\x1b[31mred')", "RuntimeError: \\x1b[31mred"),
    "interrupts": ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    "sleeps": ("import time\ntime.sleep(3600)", NO_ANSWER),
    "spins": ("while True:\n    pass", NO_ANSWER),
    "stops": ("import os\nos.kill(os.getpid(), 19)", NO_ANSWER),
    "dies": ("import os\nos.kill(os.getpid(), 9)", ENDED + "was killed by SIGKILL"),
    "segfaults": ("import ctypes\nctypes.string_at(0)", ENDED + "was killed by SIGSEGV"),
    "broken": ("def (", "SyntaxError"),
    "incomplete": ("import not_there", "ModuleNotFoundError"),
    "recurses": ("def again():\n    again()\nagain()", "RecursionError"),
    "empty": ("", "implements no hook"),
    "misspelt": (
        "from codecbench import hookimpl\n@hookimpl\ndef codecbench_codec():\n    return []",
        "implements codecbench_codec, which is not a hook",
    ),
    "unhooked": (_SPECS + "[][0]", "codecbench_codecs failed: IndexError"),
    "hook_exits": (_SPECS + "__import__('sys').exit(0)", "SystemExit: 0"),
    "silent": (_SPECS + "7", "returned 7; it must return a list of PluginSpec"),
    "textual": (_SPECS + "'jpeg'", "returned 'jpeg'; "),
    "numbered": (_SPECS + "[PluginSpec(5, 'a.b:C', '')]", "codec name 5 is not of the form"),
    "slashed": (_SPECS + "[PluginSpec('../jpeg', 'a.b:C', '')]", "codec name '../jpeg' "),
    "controlled": (_SPECS + "[PluginSpec('\\x1b[2J', 'a.b:C', '')]", "codec name '\\x1b[2J' "),
    "long": (_SPECS + "[PluginSpec('a' * 10_000, 'a.b:C', '')]", "codec name 'aaaa"),
    "untargeted": (
        _SPECS + "[PluginSpec('untargeted', 'nowhere', '')]",
        "target 'nowhere' is not package.module:Class",
    ),
    "targets_none": (_SPECS + "[PluginSpec('targets_none', None, '')]", "target None "),
    "thief": (_SPECS + "[PluginSpec('jpeg', 'a.b:C', '')]", "codec 'jpeg' is already offered by codecbench"),
    "twice": (_SPECS + "[PluginSpec('paired', 'a.b:C', '')] * 2", "codec 'paired' "),
    "requires": (_SPECS + "[PluginSpec('requires', 'a.b:C', '', requires=7)]", "requires is 7"),
    "summarised": (_SPECS + "[PluginSpec('summarised', 'a.b:C', object())]", "summary is <object"),
    "swarm": (_SPECS + "[PluginSpec(f'p{n}', 'a.b:C', '') for n in range(10**5)]", "offers 100,000 plugins"),
    "forged": (
        "import os\nfor fd in range(3, 64):\n    try:\n        os.write(fd, b'{\"value\": 3}\\n')\n"
        "    except OSError:\n        pass\nos._exit(0)",
        NONSENSE,
    ),
    "forged_error": (
        "import os\nfor fd in range(3, 64):\n    try:\n        os.write(fd, b'{\"error\": 3}\\n')\n"
        "    except OSError:\n        pass\nos._exit(0)",
        NONSENSE,
    ),
    "slams": ("import os\nos.closerange(0, 1024)", ENDED + "exited with status 1"),
    "trickles": (
        "import os, signal, time\nsignal.signal(signal.SIGALRM, signal.SIG_IGN)\nwhile time.sleep(1e-3) is None:\n"
        "    for fd in range(3, 16):\n        try:\n            os.write(fd, b' ')\n"
        "        except OSError:\n            pass",
        NO_ANSWER,
    ),
    "orphans": (
        "import os, signal\nos.kill(os.getppid(), signal.SIGKILL)\nsignal.pause()",
        ENDED + "was killed by SIGKILL",
    ),
    "forks": ("import os\nos.fork()", ""),
    "breeds": ("import os\nfor _ in range(4):\n    os.fork()", ""),
    "prints": ("print('hello from a door\\n' * 10**6)\nimport sys\nprint('hello from a door', file=sys.stderr)", ""),
    "patches": (
        "import builtins, json, numpy\njson.dumps = builtins.open = numpy.mean = lambda *_, **__: 42.0",
        ENDED + "exited with status 1",
    ),
    "lingers": (
        "import atexit, threading, time\natexit.register(time.sleep, 3600)\n"
        "threading.Thread(target=time.sleep, args=(3600,)).start()",
        "",
    ),
    "changes": (
        "import locale, os, random, resource, signal, sys, warnings\nos.chdir('/')\nos.umask(0)\nrandom.seed(0)\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\nwarnings.simplefilter('error')\nsys.setrecursionlimit(200)\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))\nos.environ.clear()",
        "",
    ),
    "cleans": (
        "import pathlib, shutil, tempfile\nfor where in (pathlib.Path(), pathlib.Path(tempfile.gettempdir())):\n"
        "    for path in where.iterdir():\n        path.is_dir() or path.unlink(missing_ok=True)\n"
        "        shutil.rmtree(path, ignore_errors=True)",
        "",
    ),
    "calls_us": (
        "import subprocess, sys\nsubprocess.Popen([sys.executable, '-m', 'codecbench', 'list'])",
        "",
    ),
}
"""By the name of the distribution: the source of its module, and why it is left out; nothing where it is not."""


def source(name: str) -> str:
    """The module of a distribution."""
    text, words = DOORS[name]
    return text + "\n" + (OFFER.replace("NAME", f"door_{name}") if not words else "")

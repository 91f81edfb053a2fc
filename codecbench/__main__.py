"""The command `codecbench`, also as `python -m codecbench`: signals are heeded before the command line is imported.

It imports next to nothing, so that little time is left in which Ctrl-C would show a traceback.
"""

from __future__ import annotations

import signal
import sys


def main() -> None:
    """Entry point: SIGTERM and SIGHUP end a command in order, as SIGINT does, with what it has started."""
    try:
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:  # under nohup, SIGHUP is ignored
                signal.signal(number, signal.default_int_handler)
        from codecbench.cli import main as command_line

        command_line()
    except KeyboardInterrupt:  # before the command line could say it, or for a second time
        sys.stderr.write("stopped\n")
        sys.exit(128 + signal.SIGINT)


if __name__ == "__main__":
    main()

"""The command `codecbench`, also run by `python -m codecbench`.

It handles signals before it imports the command line, so that Ctrl-C shows no traceback meanwhile.
"""

from __future__ import annotations

import signal
import sys


def main() -> None:
    """Run the command line. SIGTERM and SIGHUP end a command and its processes in order, as SIGINT does."""
    try:
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:  # under nohup, SIGHUP is ignored
                signal.signal(number, signal.default_int_handler)
        from codecbench.cli import main as command_line

        command_line()
    except KeyboardInterrupt:  # before the command line handles it, or a second time
        sys.stderr.write("stopped\n")
        sys.exit(128 + signal.SIGINT)


if __name__ == "__main__":
    main()

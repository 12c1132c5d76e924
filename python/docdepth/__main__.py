"""``docdepth``, and ``python -m docdepth`` where the script is not on the path."""

import os
import signal


def main() -> None:
    """Import the command line and run it.

    Imports take a second. Stopped amid them Python would end in a traceback, and so it is this that
    ends the process.
    """
    known = signal.getsignal(signal.SIGINT)
    if known is signal.default_int_handler:  # nohup has it ignored
        signal.signal(signal.SIGINT, _stop)
    from docdepth.cli import main

    signal.signal(signal.SIGINT, known)
    main()


def _stop(*_: object) -> None:
    os.write(2, b"stopped; the same command continues\n")
    os._exit(130)


if __name__ == "__main__":
    main()

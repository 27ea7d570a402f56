"""The command ``stance``: its script, and ``python -m stance``."""

import signal
import sys

from stance import _native


def main() -> int:
    """Runs the command line of this process and returns its exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        # Python's handler only sets a flag, which is not checked while Rust runs. An ignored signal, as under nohup,
        # stays ignored.
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    # Pass this file and not `-m stance`, which would first find a `stance.py` in the working folder.
    return _native.main(["stance", *sys.argv[1:]], sys.executable, __file__)


if __name__ == "__main__":
    sys.exit(main())

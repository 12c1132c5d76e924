"""How many threads there are."""

import os
import sys


def thread_count(threads: int) -> int:
    """``threads`` itself, or the number of cores that this process may use when it is 0."""
    if threads > 0:
        return threads
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1

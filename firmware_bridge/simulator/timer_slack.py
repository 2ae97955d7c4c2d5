"""Wake up on time: Linux rounds a thread's time-outs up by 50 us unless told otherwise."""

import ctypes
import sys

_SET_TIMER_SLACK = 29  # PR_SET_TIMERSLACK of linux/prctl.h
_LEAST_NS = 1


def wake_on_time() -> bool:
    """Ask for it on behalf of the calling thread; say whether the system can."""
    if not sys.platform.startswith("linux"):
        return False
    unused = ctypes.c_ulong(0)
    library = ctypes.CDLL(None)
    slack_ns = ctypes.c_ulong(_LEAST_NS)
    return int(library.prctl(_SET_TIMER_SLACK, slack_ns, unused, unused, unused)) == 0

"""The time limit of a compiled search, which reads the clock once in a while."""

import time
from typing import NamedTuple

from numba import objmode
import numpy as np
from startracker_ros.compiled import compiled

# Expected work between two readings in ns: a reading costs some microseconds.
_PERIOD_NS = 3e5


class SearchClock(NamedTuple):
    """Processor time of this thread at which a search ends; unread (1,): work since, in ns."""

    deadline_s: float
    unread: np.ndarray


@compiled
def search_clock(deadline_s: float) -> SearchClock:
    """Return the clock of a search that ends at deadline_s by time.thread_time()."""
    return SearchClock(deadline_s, np.zeros(1))


@compiled
def time_is_up(clock: SearchClock, work_ns: float) -> bool:
    """Return whether the deadline is over, after work of this expected time."""
    clock.unread[0] += work_ns
    if clock.unread[0] < _PERIOD_NS:
        return False
    with objmode(now_s='float64'):
        now_s = time.thread_time()
    # Once over it stays over: the callers of the caller see it too.
    clock.unread[0] = np.inf if now_s > clock.deadline_s else 0.0
    return now_s > clock.deadline_s

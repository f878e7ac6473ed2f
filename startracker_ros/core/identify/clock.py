# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The limit of a compiled search: processor time, or work that does not depend on the machine."""

import time
from typing import Any, NamedTuple

from numba import types
import numpy as np
from startracker_ros.core.compiled import compiled

# Expected work between two readings in ns: a reading costs a microsecond.
_PERIOD_NS = 3e5
_THREAD_CLOCK = time.CLOCK_THREAD_CPUTIME_ID
# Of the C library, the clock of time.thread_time(): a call of Python would be compiled when made.
_clock_gettime: Any = types.ExternalFunction(
    'clock_gettime', types.int32(types.int32, types.voidptr))


class SearchClock(NamedTuple):
    """
    When a search ends.

    deadline_s is the processor time of this thread, most_ns the expected time of all work on a
    processor of 3 GHz; work_ns (2,) is that since the clock was read, and in all.
    """

    deadline_s: float
    most_ns: float
    work_ns: np.ndarray


@compiled
def search_clock(deadline_s: float, most_ns: float) -> SearchClock:
    """Return the clock of a search that ends at deadline_s by time.thread_time(), or by work."""
    return SearchClock(deadline_s, most_ns, np.zeros(2))


@compiled
def time_is_up(clock: SearchClock, work_ns: float) -> bool:
    """Return whether a limit is reached, after work of this expected time."""
    clock.work_ns[1] += work_ns
    if clock.work_ns[1] > clock.most_ns:
        return True
    clock.work_ns[0] += work_ns
    if clock.work_ns[0] < _PERIOD_NS:
        return False
    # struct timespec
    now = np.empty(2, np.int64)
    _clock_gettime(_THREAD_CLOCK, now.ctypes)
    now_s = now[0] + 1e-9 * now[1]
    # Once over it stays over: the callers of the caller see it too.
    clock.work_ns[0] = np.inf if now_s > clock.deadline_s else 0.0
    return now_s > clock.deadline_s

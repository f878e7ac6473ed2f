# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The time limit of a compiled search, which reads the clock once in a while."""

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
    # struct timespec
    now = np.empty(2, np.int64)
    _clock_gettime(_THREAD_CLOCK, now.ctypes)
    now_s = now[0] + 1e-9 * now[1]
    # Once over it stays over: the callers of the caller see it too.
    clock.unread[0] = np.inf if now_s > clock.deadline_s else 0.0
    return now_s > clock.deadline_s

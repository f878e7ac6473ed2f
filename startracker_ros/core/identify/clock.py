# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The limits of a compiled search: processor time, work, or an end set by another thread."""

import time
from typing import Any, NamedTuple

from numba import types
import numpy as np
from startracker_ros.core.compiled import compiled, inlined

# Expected work between two readings in ns: a reading costs a microsecond.
_PERIOD_NS = 3e5
# Of time.thread_time() and time.monotonic().
_THREAD_CLOCK, _STEADY_CLOCK = time.CLOCK_THREAD_CPUTIME_ID, time.CLOCK_MONOTONIC
# Of the C library: a call of Python would be compiled when made.
_clock_gettime: Any = types.ExternalFunction(
    'clock_gettime', types.int32(types.int32, types.voidptr))


class SearchClock(NamedTuple):
    """
    When a search ends.

    deadline_s is the processor time of this thread, most_ns the expected time of all work on a
    processor of 3 GHz; work_ns (2,) is that since the clock was read, and in all. until_s (1,) is
    a time of time.monotonic(), which another thread may set while the search runs.
    """

    deadline_s: float
    most_ns: float
    until_s: np.ndarray
    work_ns: np.ndarray


@compiled
def search_clock(deadline_s: float, most_ns: float, until_s: np.ndarray) -> SearchClock:
    """Return the clock of a search with these limits, which begins now."""
    return SearchClock(deadline_s, most_ns, until_s, np.zeros(2))


@inlined
def _time_s(clock: int) -> float:
    """Return the time of a clock of the C library."""
    # struct timespec
    now = np.empty(2, np.int64)
    _clock_gettime(clock, now.ctypes)
    return float(now[0] + 1e-9 * now[1])


@compiled
def time_is_up(clock: SearchClock, work_ns: float) -> bool:
    """Return whether a limit is reached, after work of this expected time."""
    clock.work_ns[1] += work_ns
    if clock.work_ns[1] > clock.most_ns:
        return True
    clock.work_ns[0] += work_ns
    if clock.work_ns[0] < _PERIOD_NS:
        return False
    over = (_time_s(_THREAD_CLOCK) > clock.deadline_s
            or _time_s(_STEADY_CLOCK) > clock.until_s[0])
    # Once over it stays over: the callers of the caller see it too.
    clock.work_ns[0] = np.inf if over else 0.0
    return over

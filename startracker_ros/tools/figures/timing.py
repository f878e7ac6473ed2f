# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""CPU times of calls."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import gc
import time
from typing import ParamSpec, TypeVar

_Arguments = ParamSpec('_Arguments')
_Result = TypeVar('_Result')


def cpu_timed(function: Callable[_Arguments, _Result], *arguments: _Arguments.args,
              **options: _Arguments.kwargs) -> tuple[float, _Result]:
    """Return the process CPU time of a call in s, and what it returns."""
    start_s = time.process_time()
    result = function(*arguments, **options)
    return time.process_time() - start_s, result


@contextmanager
def garbage_collector_off() -> Iterator[None]:
    """Collect garbage now and not again until the end."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()

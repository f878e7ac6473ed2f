# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
How functions are compiled.

What Python calls with which types stands in signatures.json; warm_up.py compiles all of it
beforehand. A change of this file compiles everything anew.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit
from numba.core.types import unliteral
from startracker_ros.core.machine_code_cache import MachineCodeCache

_Function = TypeVar('_Function', bound=Callable)


def _compiler(**options: Any) -> Callable[[_Function], _Function]:
    """Return the decorator of functions that are compiled with options of numba."""
    # Other threads run meanwhile, as the one that Ctrl-C wakes and the executor during a search.
    # Division by zero gives infinity or NaN, as in NumPy: without checks code is smaller, faster.
    # Nobody calls these functions by C pointers.
    options = {'error_model': 'numpy', 'no_cfunc_wrapper': True, 'nogil': True, **options}
    jit: Any = njit(**options)

    def compile_with_cache(function: _Function) -> _Function:
        dispatcher = jit(function)
        # With NUMBA_DISABLE_JIT it is the function itself.
        if hasattr(dispatcher, '_cache'):
            dispatcher.get_call_template = _without_literals(dispatcher.get_call_template)
            dispatcher._cache = MachineCodeCache(dispatcher)
        return dispatcher
    return compile_with_cache


def _without_literals(template: Callable) -> Callable:
    """Compile a function once for integers, not again for each constant that it is called with."""
    return lambda args, kws: template(
        [unliteral(one) for one in args], {name: unliteral(one) for name, one in kws.items()})


compiled = _compiler()
# A product and a sum may be one instruction, rounded once: faster, but the last bits may differ
# between machines.
fused = _compiler(fastmath={'contract'})
# Nor is the order of a sum fixed, so that several of its terms are added at once.
reordered = _compiler(fastmath={'contract', 'reassoc'})
inlined = _compiler(inline='always')

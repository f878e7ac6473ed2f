"""
How functions are compiled.

The first call on a machine compiles, which takes seconds; warm_up.py does it beforehand.
"""

from typing import Any

from numba import config, njit
from startracker_ros.machine_code import machine_code_folder

# Numba gives its settings their names when it is loaded.
settings: Any = config
# What the user has set stays. Where nothing can be written each process compiles anew.
if not settings.CACHE_DIR:
    settings.CACHE_DIR = machine_code_folder()
_kept = bool(settings.CACHE_DIR)

# Division by zero gives infinity or NaN, as in NumPy: without checks code is smaller and faster.
compiled = njit(cache=_kept, error_model='numpy')
# A product and a sum may be one instruction, rounded once: faster, but the last bits may differ
# between machines.
fused = njit(cache=_kept, error_model='numpy', fastmath={'contract'})
# Nor is the order of a sum fixed, so that several of its terms are added at once.
reordered = njit(cache=_kept, error_model='numpy', fastmath={'contract', 'reassoc'})
inlined = njit(cache=_kept, error_model='numpy', inline='always')

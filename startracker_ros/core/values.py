# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Arguments of the library: what is not a value of a kind is named."""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

_Kind = TypeVar('_Kind')


def of_type(name: str, value: object, kind: type[_Kind], how: str) -> _Kind:
    """Return a value of a type; ValueError for another one says how to make it."""
    if not isinstance(value, kind):
        raise ValueError(f'{name} is of type {type(value).__name__}, must be {kind.__name__}: '
                         f'{how}')
    return value


def vector_of(name: str, value: ArrayLike) -> np.ndarray:
    """Return a value as float64 (3,); ValueError."""
    try:
        vector = np.asarray(value, float)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f'{name} = {value!r} must be three finite numbers')
    return vector

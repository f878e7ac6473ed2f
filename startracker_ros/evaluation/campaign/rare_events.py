# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Probabilities of rare events of normal values, by importance sampling.

The event is that of n ~ N(0, I). Values are drawn from the mixture of N(m_k, I), k = 1 .. K of
equal shares, with shifts m_k that lead into the event, and each counts with the ratio of the
densities, w = K / sum_k exp(m_k n - m_k^2 / 2) (Owen and Zhou, J. Amer. Stat. Assoc. 95, 2000).
The shift zero should be among them where the event has parts that the others do not show: then
no weight exceeds K.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Found(NamedTuple):
    """A probability and its standard error."""

    probability: float
    error: float


def probability_of(event: Callable[[np.ndarray], np.ndarray], shifts: np.ndarray, draws: int,
                   rng: np.random.Generator) -> Found:
    """Return the probability that event(n), a mask (M,) of values n (M, D), is true."""
    count, size = shifts.shape
    n = rng.standard_normal((draws, size)) + shifts[rng.integers(count, size=draws)]
    exponents = n @ shifts.T - np.sum(shifts ** 2, axis=1) / 2
    largest = exponents.max(axis=1)
    mixture = np.exp(exponents - largest[:, None]).mean(axis=1)
    weighted = np.where(event(n), np.exp(-largest) / mixture, 0.0)
    return Found(float(weighted.mean()), float(weighted.std(ddof=1) / np.sqrt(draws)))

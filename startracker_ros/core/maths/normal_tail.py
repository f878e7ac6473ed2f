# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of a normal distribution that are possible, but improbable: compiled."""

import math

from startracker_ros.core.compiled import compiled


@compiled
def tail_sigmas(probability: float, missed: float) -> float:
    """
    Return the c beyond which such an error lies on one side with no more than a probability.

    The error itself has the probability p: p exp(-c^2 / 2) / 2 = missed (a bound of the normal
    integral). 0 where no c is needed.
    """
    if probability <= 2 * missed:
        return 0.0
    return math.sqrt(2 * math.log(probability / (2 * missed)))

"""Stellar aberration: where a moving observer sees the stars."""

import numpy as np
from startracker_ros.astro.constants import SPEED_OF_LIGHT_M_S


def aberrate(directions: np.ndarray, velocity_m_s: np.ndarray) -> np.ndarray:
    """
    Return unit vectors (N, 3) as seen at velocity_m_s (3,), of directions (N, 3) seen at rest.

    Special relativity, Explanatory Supplement to the Astronomical Almanac (3rd ed.), 7.41.
    """
    beta = velocity_m_s / SPEED_OF_LIGHT_M_S
    shrink = np.sqrt(1 - beta @ beta)
    cosine = directions @ beta
    seen = (shrink * directions + (1 + cosine / (1 + shrink))[:, None] * beta)
    return seen / (1 + cosine)[:, None]

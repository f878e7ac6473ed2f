"""Stellar aberration: the directions that a moving observer sees."""

import numpy as np
from startracker_ros.astro.constants import SPEED_OF_LIGHT_M_S


def aberrate(directions: np.ndarray, velocity_m_s: np.ndarray) -> np.ndarray:
    """
    Return apparent unit vectors (N, 3) for an observer at velocity_m_s (3,).

    directions (N, 3) are those seen by an observer at rest. Special relativity, Explanatory
    Supplement to the Astronomical Almanac (3rd ed.), 7.41:
    p' = (p / gamma + (1 + p.beta / (1 + 1 / gamma)) beta) / (1 + p.beta).
    """
    beta = velocity_m_s / SPEED_OF_LIGHT_M_S
    inverse_gamma = np.sqrt(1 - beta @ beta)
    p_beta = directions @ beta
    numerator = (inverse_gamma * directions
                 + (1 + p_beta / (1 + inverse_gamma))[:, None] * beta)
    return numerator / (1 + p_beta)[:, None]

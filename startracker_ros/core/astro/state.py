# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Position and velocity of a satellite as navigation reports them."""

from typing import NamedTuple

import numpy as np


class State(NamedTuple):
    """Position (3,) in m, velocity (3,) in m/s, covariance (3, 3) of the position in m^2."""

    position_m: np.ndarray
    velocity_m_s: np.ndarray
    covariance_m2: np.ndarray

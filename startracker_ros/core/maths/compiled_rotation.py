# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Single rotations for compiled functions."""

import numpy as np
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths import rotation as formulas

_matrix_rows = compiled(formulas.matrix_rows)


@compiled
def matrix_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,)."""
    return np.array(_matrix_rows(q))

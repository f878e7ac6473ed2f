# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Single quaternions, for compiled functions and where NumPy takes ten times as long."""

import numpy as np
from startracker_ros.core.compiled import compiled
from startracker_ros.core.maths import quaternion

_product = compiled(quaternion.product)


@compiled
def multiplied(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Hamilton product a b of two quaternions (4,): first b, then a."""
    return np.array(_product(a, b))


@compiled
def rotation_between(q: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) rad about the axes of q (4,) to another attitude (4,)."""
    x, y, z, w = _product((-q[0], -q[1], -q[2], q[3]), other)
    if w < 0:
        x, y, z, w = -x, -y, -z, -w
    sine = np.sqrt(x * x + y * y + z * z)
    scale = 2 * np.arctan2(sine, w) / sine if sine > 0 else 2.0
    return np.array((scale * x, scale * y, scale * z))

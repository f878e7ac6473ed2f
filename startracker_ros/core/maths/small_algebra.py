# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Small vectors and symmetric matrices, compiled: a fraction of the time of LAPACK."""

import numpy as np
from startracker_ros.core.compiled import compiled


@compiled
def adjugate(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
             ) -> tuple[float, float, float, float, float, float]:
    """Return the elements xx, xy, xz, yy, yz, zz of adj(A) = det(A) A^-1, A symmetric."""
    return (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy,
            xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy)


@compiled
def inverse(A: np.ndarray) -> np.ndarray:
    """Return adj(A) / det(A) (3, 3) of the upper left block of A; not finite if singular."""
    xx, xy, xz, yy, yz, zz = adjugate(A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2])
    scale = 1 / (A[0, 0] * xx + A[0, 1] * xy + A[0, 2] * xz)
    return np.array(((xx * scale, xy * scale, xz * scale), (xy * scale, yy * scale, yz * scale),
                     (xz * scale, yz * scale, zz * scale)))

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Vectors and symmetric matrices of three rows as scalars, for compiled functions."""

from startracker_ros.core.compiled import compiled


@compiled
def cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float
          ) -> tuple[float, float, float]:
    """Return a x b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@compiled
def adjugate(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
             ) -> tuple[float, float, float, float, float, float]:
    """Return the elements xx, xy, xz, yy, yz, zz of adj(A) = det(A) A^-1, A symmetric."""
    return (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy,
            xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy)

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the fusion knows of the attitude of a head that has lost its stars."""

from startracker_ros.core.fusion.fusion import AttitudeFusion, FusedAttitude
from startracker_ros.core.maths.rotation import matrix_from_quaternion, multiply
from startracker_ros.core.track.tracks import Hint


def hint_for(fusion: AttitudeFusion, name: str, fused: FusedAttitude) -> Hint:
    """Return the fused attitude and rate on the axes of a head, with the error of its mount."""
    mount, covariance = fusion.mounts.at(name, fused.stamp_ns)
    R = matrix_from_quaternion(mount)
    return Hint(fused.stamp_ns, multiply(fused.quaternion, mount),
                R.T @ (fused.covariance + covariance) @ R,
                R.T @ fused.rate_rad_s, R.T @ fused.rate_covariance @ R)

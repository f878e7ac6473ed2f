# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The mounts of all heads as learnt so far: out of the state of the fusion, or of the file."""

from collections.abc import Mapping

import numpy as np
from startracker_ros.core.fusion.head import Head
from startracker_ros.core.fusion.mounts import Mount
from startracker_ros.core.fusion.state import BODY, FusedState
from startracker_ros.core.fusion.steps import MountStep
from startracker_ros.core.maths.rotation import multiply, quaternion_from_rotation_vector


class MountBank:
    """coefficients (M,) rad of all mounts and their covariance (M, M), by the newest state."""

    def __init__(self, heads: Mapping[str, Head]) -> None:
        self._heads = heads
        self.reset()

    def reset(self) -> None:
        """Return to what files and options have."""
        priors = [head.prior for head in self._heads.values()]
        self.coefficients = np.concatenate([mean for mean, _ in priors])
        self.covariance = np.zeros((len(self.coefficients), len(self.coefficients)))
        for head, (_, covariance) in zip(self._heads.values(), priors):
            own = own_coefficients(head)
            self.covariance[own, own] = covariance

    def follow(self, state: FusedState) -> None:
        """Use the mounts of a state."""
        self.coefficients, self.covariance = state.coefficients, state.covariance[BODY:, BODY:]

    def learnt(self) -> dict[str, Mount]:
        """Return the mounts for the file."""
        return {name: head.learnt(self.coefficients[own_coefficients(head)],
                                  self.covariance[own_coefficients(head), own_coefficients(head)])
                for name, head in self._heads.items()}

    def misalignment(self, name: str, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Return what a mount differs from its file (3,) rad, and its covariance (3, 3)."""
        head = self._heads[name]
        B, own = head.sensitivity(stamp_ns), own_coefficients(head)
        return B @ self.coefficients[own], B @ self.covariance[own, own] @ B.T

    def at(self, name: str, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Return q_body_from_sensor (4,) at a time, bent as learnt, and its covariance (3, 3)."""
        offset, covariance = self.misalignment(name, stamp_ns)
        mount = self._heads[name].mount.quaternion
        return multiply(quaternion_from_rotation_vector(offset), mount), covariance

    def implausible(self, stamp_ns: int) -> list[Head]:
        """Return the heads whose mounts have left what their files allow."""
        return [head for head in self._heads.values() if not head.is_plausible(
            self.coefficients[own_coefficients(head)], stamp_ns)]


def own_coefficients(head: Head) -> slice:
    """Return the slice of a head in the coefficients (M,) of all."""
    return slice(head.columns.start - BODY, head.columns.stop - BODY)


def reopened(state: FusedState, head: Head, step: MountStep) -> FusedState:
    """Return a state that does not know the mount that has made a step."""
    first, P = head.columns.start, state.covariance.copy()
    P[range(first, first + 3), range(first, first + 3)] += float(step.size_rad @ step.size_rad)
    return state._replace(covariance=P)

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Several heads, one attitude of the body: each head is checked against the others and the gyro.

The fusion is that of the native core, native/include/startracker_fusion.h. Frames may come late
and out of order.
"""

from collections.abc import Mapping
import ctypes
from dataclasses import dataclass

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.fusion.head import Head, HeadFrame
from startracker_ros.core.fusion.mounts import Mount, mount_of, MountOptions
from startracker_ros.core.fusion.native_fusion import NativeFusion
from startracker_ros.core.fusion.options import FusionOptions
from startracker_ros.core.maths.rotation import matrix_from_quaternion, multiply
from startracker_ros.core.track.tracks import Hint


@dataclass(frozen=True)
class FusedAttitude:
    """
    The attitude of the body at a stamp.

    quaternion (4,) is q_icrf_from_body, covariance (3, 3) rad^2 about body axes; rate and drift
    (3,) rad/s about body axes with their covariances (3, 3).
    """

    stamp_ns: int
    quaternion: np.ndarray
    covariance: np.ndarray
    rate_rad_s: np.ndarray
    rate_covariance: np.ndarray
    drift_rad_s: np.ndarray
    drift_covariance: np.ndarray


@dataclass(frozen=True)
class MountStep:
    """A step of a mount against the reference: size (3,) rad about body axes, 1 sigma (3,)."""

    head: str
    stamp_ns: int
    size_rad: np.ndarray
    sigma_rad: np.ndarray


class AttitudeFusion:
    """
    Fuses the frames of heads, in any order, and rates about body axes.

    mounts by name are those of the file; the first is the reference, whose mount defines the
    body. heads are by name, mounts what is estimated of theirs; steps are the steps of mounts that
    were found, to be subtracted by the caller. ValueError as of NativeFusion.
    """

    def __init__(self, mounts: Mapping[str, Mount], options: FusionOptions = FusionOptions(),
                 mount_options: MountOptions = MountOptions(),
                 gyro_options: GyroErrorOptions = GyroErrorOptions()) -> None:
        self._native = NativeFusion(mounts, options, mount_options, gyro_options)
        self.heads = {name: Head(self._native, number)
                      for name, number in self._native.numbers.items()}
        self.mounts = MountBank(self._native)
        self.steps: list[MountStep] = []
        self._rate, self._quaternion, self._covariance = (
            np.empty(shape) for shape in ((3,), (4,), (3, 3)))
        self._fused = np.zeros((), native.FUSED)
        self._rate_at = self._rate.ctypes.data
        self._frame_at = tuple(one.ctypes.data for one in (
            self._quaternion, self._covariance, self._fused))

    def reset(self) -> None:
        """Forget attitude, gyro and frames; the mounts are those of the file again."""
        self._native.call('reset')
        self.steps.clear()

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """
        Add a rate (3,) about body axes; False if it is rejected or not newer than the last.

        A jump of time back by more than a second is another gyro.
        """
        self._rate[:] = rate_rad_s
        return not self._native.status_of('add_rate', stamp_ns, self._rate_at)

    def add_frame(self, name: str, frame: HeadFrame) -> FusedAttitude | None:
        """Add a frame of a head; return the attitude at its stamp if it counts as the newest."""
        self._quaternion[:], self._covariance[:] = frame.quaternion, frame.covariance
        self._native.call(
            'add_frame', self._native.numbers[name], frame.stamp_ns, *self._frame_at)
        self.steps += [MountStep(self._native.names[step['head']], int(step['stamp_ns']),
                                 step['size_rad'], step['sigma_rad'])
                       for step in self._native.steps()]
        fused = self._fused
        if not fused['valid']:
            return None
        return FusedAttitude(int(fused['stamp_ns']), *(fused[field].copy() for field in (
            'quaternion', 'covariance_rad2', 'rate_rad_s', 'rate_covariance', 'drift_rad_s',
            'drift_covariance')))

    def is_missing(self, name: str, stamp_ns: int) -> bool:
        """Return whether a head has had no frame that counts for so long that it is silent."""
        return self.heads[name].is_silent(stamp_ns)

    @property
    def trouble(self) -> str:
        """Return why there is no attitude, empty if there is one."""
        reason = np.empty((), native.REASON)
        self._native.call('state', reason.ctypes.data, None, None)
        return self._native.sentence(reason)

    @property
    def gyro_trouble(self) -> str:
        """Return why the rates of a gyro are not used, empty where they are or without one."""
        reason = np.empty((), native.REASON)
        self._native.call('state', None, reason.ctypes.data, None)
        return self._native.sentence(reason)

    @property
    def uses_gyro(self) -> bool:
        """Return whether the rates of a gyro are used."""
        uses = ctypes.c_int32()
        self._native.call('state', None, None, ctypes.byref(uses))
        return bool(uses.value)


class MountBank:
    """The mounts of all heads as estimated so far."""

    def __init__(self, fusion: NativeFusion) -> None:
        self._fusion = fusion

    def estimated(self) -> dict[str, Mount]:
        """Return the mounts for the file."""
        mount, estimated = np.zeros((), native.MOUNT), {}
        for name, number in self._fusion.numbers.items():
            self._fusion.call('learnt', number, mount.ctypes.data)
            estimated[name] = mount_of(mount)
        return estimated

    def misalignment(self, name: str, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Return what a mount differs from its file (3,) rad, and its covariance (3, 3)."""
        _, offset, covariance = self._known(name, stamp_ns)
        return offset, covariance

    def at(self, name: str, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Return q_body_from_sensor (4,) at a time, bent, and its covariance (3, 3)."""
        mount, _, covariance = self._known(name, stamp_ns)
        return mount, covariance

    def _known(self, name: str, stamp_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        known = np.empty(4), np.empty(3), np.empty((3, 3))
        self._fusion.call('mount', self._fusion.numbers[name], stamp_ns,
                          *(one.ctypes.data for one in known))
        return known


def hint_for(fusion: AttitudeFusion, name: str, fused: FusedAttitude) -> Hint:
    """Return the fused attitude and rate on the axes of a head, with the error of its mount."""
    mount, covariance = fusion.mounts.at(name, fused.stamp_ns)
    R = matrix_from_quaternion(mount)
    return Hint(fused.stamp_ns, multiply(fused.quaternion, mount),
                R.T @ (fused.covariance + covariance) @ R,
                R.T @ fused.rate_rad_s, R.T @ fused.rate_covariance @ R)

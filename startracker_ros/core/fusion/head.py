# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One head: its mount in the state of the fusion, its frames, and whether it counts."""

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
import math

import numpy as np
from startracker_ros.core.astro.epoch import RESTART_NS
from startracker_ros.core.fusion.mounts import basis, Mount, MountOptions
from startracker_ros.core.fusion.state import body_attitude, GATE, Measurement
from startracker_ros.core.maths.rotation import (
    ARCSEC, conjugate, matrix_from_quaternion, multiply, quaternion_from_rotation_vector)

HOUR_S = 3600.0
_REMEMBERED = 64  # stamps of one head
_SILENT_RATIO = 3.0
_ROUNDING_RAD2 = (0.01 * ARCSEC) ** 2
_HOTTEST_C = 150.0  # of electronics; in kelvin that would be colder than any head

_MEAN = 3.0  # of the normalised innovation squared of an attitude
_FRAMES = 32  # over which it is averaged
_SUSPICIOUS = 1.5  # times that of the best other head; 5 sigma of the average
_RATE = 1 / 48  # slower than the average, so that the scale does not oscillate


class HeadState(StrEnum):
    """Whether the frames of a head count."""

    WAITING = 'waiting'
    CHECKED = 'checked'
    USED = 'used'
    EXCLUDED = 'excluded'


@dataclass(frozen=True)
class HeadFrame:
    """
    A measured attitude of a head.

    quaternion (4,) is q_icrf_from_sensor, covariance (3, 3) rad^2 about sensor axes. ValueError
    when these are no attitude.
    """

    stamp_ns: int
    quaternion: np.ndarray
    covariance: np.ndarray

    def __post_init__(self) -> None:
        # Python's floats: NumPy takes ten times as long for so few numbers.
        q, C = self.quaternion.tolist(), self.covariance.tolist()
        # Written so that NaN is rejected.
        if not abs(math.hypot(*q) - 1) < 1e-6:
            raise ValueError(f'quaternion {q} is no attitude')
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = C
        # Sylvester's criterion.
        minor = xx * yy - xy * yx
        determinant = (xx * (yy * zz - yz * zy) - xy * (yx * zz - yz * zx)
                       + xz * (yx * zy - yy * zx))
        if not (0 < xx < math.inf and 0 < minor < math.inf and 0 < determinant < math.inf):
            raise ValueError(f'covariance {C} is not positive definite')


class Head:
    """
    A head and its share of the state.

    columns are those of its coefficients in the error state, none for the reference, whose mount
    defines the body; stepped_rad2 is the square of the steps of its mount that were found.
    noise has the scale of its covariance. needs_temperature: its mount bends with a temperature
    that has not come. counts are of its frames by what became of them; reason is why it does not
    count.
    """

    def __init__(self, name: str, mount: Mount, options: MountOptions, first_column: int,
                 is_reference: bool, correlation_s: float) -> None:
        self.name = name
        self.mount = mount
        self.is_reference = is_reference
        self._options = options
        self._correlation_s = correlation_s
        # A law of the file counts, whatever may be learnt beside it.
        law = np.zeros((3, 3)) if mount.law is None else mount.law
        self.terms = [] if is_reference else [
            0, *([1] if options.mount_temperature_arcsec_k or law[0].any() else []),
            *([2, 3] if options.mount_orbit_arcsec or law[1:].any() else [])]
        self._constant = np.eye(3, 3 * len(self.terms))
        size = 3 * len(self.terms)
        self.columns = slice(first_column, first_column + size)
        self._sensor_from_body = conjugate(mount.quaternion)
        self._matrix = matrix_from_quaternion(mount.quaternion)
        self._temperature_k = 0.0
        self.needs_temperature = 1 in self.terms
        self.counts: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget the frames."""
        self.state, self.reason = HeadState.WAITING, 'no frames yet'
        self.agreed: list[float] = []
        self.disagreed = 0
        self.recent: deque[HeadFrame] = deque(maxlen=2)
        self.used_ns: int | None = None
        self.stepped_rad2 = 0.0
        self.noise = HeadNoise()
        self._first_ns = 0
        self._stamps: deque[int] = deque(maxlen=_REMEMBERED)
        self._interval_s = 0.0

    # --- the mount ---

    @cached_property
    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (3 K,) and covariance (3 K, 3 K) of the coefficients by file and options."""
        if self.is_reference:
            return np.zeros(0), np.zeros((0, 0))
        sigma = ARCSEC * np.array([
            self._options.mount_sigma_arcsec, self._options.mount_temperature_arcsec_k,
            self._options.mount_orbit_arcsec, self._options.mount_orbit_arcsec])
        covariance = np.diag(np.repeat(sigma ** 2, 3))
        if self.mount.covariance is not None:
            covariance[:3, :3] = self.mount.covariance
        if self.mount.law_covariance is not None:
            covariance = self.mount.law_covariance
        mean = np.zeros(12)
        if self.mount.law is not None:
            mean[3:] = self.mount.law.ravel()
        chosen = self._chosen
        return mean[chosen], covariance[np.ix_(chosen, chosen)]

    @property
    def _chosen(self) -> np.ndarray:
        """Return the elements (3 K,) of the terms in the twelve of a mount."""
        return np.add.outer(3 * np.array(self.terms), np.arange(3)).ravel()

    def is_plausible(self, coefficients: np.ndarray, stamp_ns: int) -> bool:
        """
        Return whether a mount may have come to coefficients (3 K,) from what its file has.

        Frame by frame a head that is wrong by less than its gate could bend its mount to fit.
        """
        if self.is_reference:
            return True
        B, (mean, covariance) = self.sensitivity(stamp_ns), self.prior
        self._first_ns = self._first_ns or stamp_ns
        walked = self.walk()[0] * abs(stamp_ns - self._first_ns) * 1e-9
        difference = B @ (coefficients - mean)
        allowed = B @ covariance @ B.T + (walked + self.stepped_rad2 + _ROUNDING_RAD2) * np.eye(3)
        return float(difference @ np.linalg.solve(allowed, difference)) <= GATE

    def walk(self) -> np.ndarray:
        """Return the spectral densities (3 K,) rad^2/s of the coefficients."""
        densities = np.zeros(self.columns.stop - self.columns.start)
        densities[:3] = (self._options.mount_walk_arcsec_sqrt_h * ARCSEC) ** 2 / HOUR_S
        return densities

    def set_temperature(self, celsius: float) -> bool:
        """Use a temperature; False for one that no head has: NaN, or one in kelvin."""
        if not -273.15 <= celsius <= _HOTTEST_C:
            return False
        self.needs_temperature = False
        if math.isnan(self.mount.temperature_c):
            self.mount = replace(self.mount, temperature_c=celsius)
        self._temperature_k = celsius - self.mount.temperature_c
        return True

    def sensitivity(self, stamp_ns: int) -> np.ndarray:
        """Return d(misalignment) / d(coefficients) (3, 3 K), (3, 0) for the reference."""
        if len(self.terms) < 2:
            return self._constant
        phi = basis(stamp_ns, self._temperature_k, self._options.orbit_period_s)[self.terms]
        matrix = np.zeros((3, 3 * len(phi)))
        for axis in range(3):
            matrix[axis, axis::3] = phi
        return matrix

    def learnt(self, coefficients: np.ndarray, covariance: np.ndarray) -> Mount:
        """Return the mount with coefficients (3 K,) and their covariance (3 K, 3 K)."""
        if self.is_reference:
            return replace(self.mount, covariance=None)
        whole, chosen = np.zeros(12), self._chosen
        whole[chosen] = coefficients
        whole_covariance = np.zeros((12, 12))
        whole_covariance[np.ix_(chosen, chosen)] = covariance
        quaternion = multiply(quaternion_from_rotation_vector(whole[:3]), self.mount.quaternion)
        law = len(self.terms) > 1
        return replace(self.mount, quaternion=quaternion, covariance=covariance[:3, :3],
                       law=whole[3:].reshape(3, 3) if law else None,
                       law_covariance=whole_covariance if law else None)

    # --- frames ---

    def accept(self, frame: HeadFrame) -> HeadFrame | None:
        """
        Return a frame on the time of the body, as the next of recent; None if it is repeated.

        Frames whose errors are correlated by rho = exp(-dt / correlation_s) have the information
        of independent ones of (1 + rho) / (1 - rho) times their covariance (mean of an AR(1)).
        """
        if self.mount.time_offset_s:
            frame = replace(
                frame, stamp_ns=frame.stamp_ns - round(self.mount.time_offset_s * 1e9))
        if frame.stamp_ns in self._stamps:
            return None
        if self._stamps:
            step_s = abs(frame.stamp_ns - self._stamps[-1]) * 1e-9
            self._interval_s = step_s if len(self._stamps) == 1 else (
                self._interval_s + 0.2 * (min(step_s, 2 * self._interval_s) - self._interval_s))
        self._stamps.append(frame.stamp_ns)
        if self._correlation_s and self._interval_s:
            rho = math.exp(-self._interval_s / self._correlation_s)
            frame = replace(frame, covariance=frame.covariance * ((1 + rho) / (1 - rho)))
        if self.noise.scale > 1:
            frame = replace(frame, covariance=frame.covariance * self.noise.scale)
        if self.recent and self.recent[-1].stamp_ns - frame.stamp_ns > RESTART_NS:
            self.recent.clear()
        if not self.recent or frame.stamp_ns > self.recent[-1].stamp_ns:
            self.recent.append(frame)
        return frame

    def measurement(self, frame: HeadFrame, coefficients: np.ndarray) -> Measurement:
        """Return the attitude of the body by a frame; coefficients (3 K,) are those of now."""
        sensitivity = self.sensitivity(frame.stamp_ns)
        return Measurement(*body_attitude(
            frame.quaternion, self._sensor_from_body, self._matrix, frame.covariance, sensitivity,
            coefficients), self.columns, sensitivity)

    def is_silent(self, stamp_ns: int, gap_s: float) -> bool:
        """Return whether the last frame that counted is too old for one that counts."""
        return self.used_ns is None or (stamp_ns - self.used_ns) * 1e-9 > max(
            gap_s, _SILENT_RATIO * self._interval_s)

    def has_frames(self, stamp_ns: int, gap_s: float) -> bool:
        """Return whether its last frame is no further than gap_s from a time."""
        return bool(self.recent) and abs(stamp_ns - self.recent[-1].stamp_ns) * 1e-9 <= gap_s

    def enter(self, state: HeadState, reason: str = '') -> None:
        """Enter a state."""
        self.state, self.reason = state, reason
        self.agreed.clear()
        self.disagreed = 0


class HeadNoise:
    """
    The scale by which the covariance of a head is multiplied.

    It matches the normalised innovation squared (NIS) with its expectation (covariance matching,
    Mehra, IEEE Trans. Autom. Control 17, 1972). Only a head that stands out from the best of the
    others is scaled: a manoeuvre or a wrong gyro enlarges the innovations of all heads.
    """

    def __init__(self) -> None:
        self.scale = 1.0
        self._nis = _MEAN

    @property
    def stands_out(self) -> bool:
        """Whether the errors are so large that a user should know."""
        return self.scale > _SUSPICIOUS

    def add(self, nis: float, others: Iterable['HeadNoise']) -> None:
        """Use the NIS of a frame; others are those of the other heads that count, if any."""
        self._nis += (min(nis, GATE) - self._nis) / _FRAMES
        expected = min((other._nis for other in others), default=None)
        if expected is None:
            return
        ratio = self._nis / max(expected, _MEAN)
        if ratio > _SUSPICIOUS or self.scale > 1:
            self.scale = max(1.0, self.scale * (1 + _RATE * (ratio - 1)))

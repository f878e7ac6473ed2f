# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Calibration in flight: a lens filter, and cameras proposed only after proof on frames left out.

Every fourth frame is left out of the filter. A camera is proposed when the estimated lens differs
significantly from that in use, when that moves stars visibly against each other, and when it fits
the frames left out better: by chi-square, and by three standard errors of their mean.
"""

from collections import deque
from dataclasses import dataclass
import math

import numpy as np
from scipy.special import chdtrc
from startracker_ros.core.calibration.collection import CollectionOptions
from startracker_ros.core.calibration.estimate import star_shift
from startracker_ros.core.calibration.lens_filter import LENS, LensFilter, LensFrame
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.maths.rotation import conjugate
from startracker_ros.core.options import option, Options

_LEFT_OUT = 4  # every fourth frame
_LEAST_LEFT_OUT, _MOST_LEFT_OUT = 8, 24
_PARAMETERS = (slice(0, 1), slice(1, 3), slice(3, 4))  # focal length, principal point, k1
# Of chance alone: parameters are compared with those in use at every frame left out.
_SIGNIFICANCE = 1e-4
_LEAST_GAIN, _GAIN_SIGMAS = 9.0, 3.0
# A smaller change is not worth that all nodes restart.
_LEAST_CHANGE_PX = 0.02
_GRID = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * 2), -1).reshape(-1, 2)
_NORTH = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class OnlineOptions(Options):
    """Calibration from tracked stars."""

    calibration_mode: str = option(
        'on_request', 'on_request: only by ~/calibrate; propose: tracked stars are used all the '
        'time, a better camera is published as proposed_camera_info and written to output_file; '
        'apply: it is also set in the source by set_camera_info',
        choices=('on_request', 'propose', 'apply'), read_only=True)
    lens_sigma_px: float = option(
        1.0, 'how well camera_info is known at the start: 1 sigma of focal length, principal '
        'point and k1 each, as shift of a star in the corner', unit='px', low=0.001, high=100.0)
    lens_walk_px_sqrt_h: float = option(
        0.02, 'random walk of each of them, which no temperature explains', unit='px/sqrt(h)',
        low=0.0, high=10.0)


@dataclass(frozen=True)
class Proposal:
    """
    A camera that fits frames left out better than the one in use.

    changes are the names of the parameters that changed; chi_square_before and chi_square_after
    are sums over the stars of frames that the estimate has not used; change_px is the largest
    shift of a star that no attitude explains.
    """

    camera: Camera
    changes: tuple[str, ...]
    change_px: float
    frames: int
    chi_square_before: float
    chi_square_after: float

    def __str__(self) -> str:
        """Return the proposal in one line."""
        return (f'{", ".join(self.changes)} changed by up to {self.change_px:.2g} px: chi-square '
                f'of {self.frames} frames left out {self.chi_square_before:.0f} before, '
                f'{self.chi_square_after:.0f} after')


class OnlineCalibration:
    """
    Estimates the lens of a camera from tracked stars.

    used is the camera in use; filter has the estimate. frames counts those used, left out
    and of a pointing already there.
    """

    def __init__(self, camera: Camera, options: OnlineOptions = OnlineOptions(),
                 collection: CollectionOptions = CollectionOptions()) -> None:
        self.used = camera
        self.filter = LensFilter(camera, options.lens_sigma_px, options.lens_walk_px_sqrt_h)
        self.frames = {'used': 0, 'left out': 0, 'pointing already there': 0}
        self._min_shift = collection.min_shift_percent / 100
        self._proposed: np.ndarray | None = None
        self._left_out: deque[LensFrame] = deque(maxlen=_MOST_LEFT_OUT)
        self._pointing: np.ndarray | None = None

    def add(self, frame: LensFrame) -> Proposal | None:
        """
        Use a frame, or leave it out; return the camera that is better than the one in use, if any.

        Stars at the same pixels have the same errors, so only frames of another pointing are used.
        CalibrationError says why a frame cannot be of this camera.
        """
        if self._pointing is not None and star_shift(
                self.used, frame.quaternion, self._pointing) < self._min_shift:
            self.frames['pointing already there'] += 1
            return None
        frame = self.filter.checked(frame)
        self._pointing = frame.quaternion
        if (self.frames['used'] + self.frames['left out'] + 1) % _LEFT_OUT:
            self.filter.update(frame)
            self.frames['used'] += 1
            return None
        self._left_out.append(frame)
        self.frames['left out'] += 1
        return self._proposal(frame.temperature_c) if len(
            self._left_out) >= _LEAST_LEFT_OUT else None

    def use(self, camera: Camera) -> None:
        """Continue with another camera in use, such as one that was proposed."""
        self.used = camera
        self._proposed = None

    def _proposal(self, temperature_c: float) -> Proposal | None:
        """Return the significantly different camera if the frames left out prove it."""
        used = self.filter.lens_of(self.used)
        estimate, covariance = self.filter.at(temperature_c)
        change = _significant(estimate - used, covariance)
        change_px = self._visible_px(change)
        if change_px < _LEAST_CHANGE_PX:
            return None
        # What has been proposed already, and is not in use, is not proposed again.
        if self._proposed is not None and self._visible_px(
                used + change - self._proposed) < _LEAST_CHANGE_PX:
            return None
        try:
            camera = self.filter.camera(used + change)
            after = self._chi_squares(used + change, temperature_c)
        except CameraError:
            return None
        before = np.array([self._chi_square(self.used, frame) for frame in self._left_out])
        gain = before - after
        sigma = float(np.std(gain, ddof=1)) * math.sqrt(len(gain))
        if gain.sum() < max(_LEAST_GAIN, _GAIN_SIGMAS * sigma):
            return None
        self._proposed = used + change
        names = ('focal', 'centre', 'k1')
        changes = tuple(name for name, own in zip(names, _PARAMETERS) if change[own].any())
        return Proposal(camera, changes, change_px, len(gain), float(before.sum()),
                        float(after.sum()))

    def _chi_squares(self, lens: np.ndarray, temperature_c: float) -> np.ndarray:
        """Return the chi-square (F,) of the frames left out, at the temperature of each."""
        now = self.filter.at(temperature_c)[0]
        return np.array([self._chi_square(self.filter.camera(
            lens + self.filter.at(frame.temperature_c)[0] - now), frame)
            for frame in self._left_out])

    def _chi_square(self, camera: Camera, frame: LensFrame) -> float:
        _, residual = self.filter.reduced(camera, frame)
        return float(residual @ residual)

    def _visible_px(self, change: np.ndarray) -> float:
        """Return the largest shift of a star by a change that no attitude explains."""
        camera = self.used
        uv = _GRID * [camera.width - 1, camera.height - 1]
        frame = LensFrame(0, uv, np.ones(len(uv)), camera.unproject(uv), conjugate(_NORTH))
        design, _ = self.filter.reduced(camera, frame)
        shift = math.sqrt(self.filter.variance) * (design @ change).reshape(-1, 2)
        return float(np.hypot(*shift.T).max())


def _significant(change: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """
    Return the change (4,) with all parameters at zero that do not differ from it significantly.

    Backward elimination by Wald tests. With the others at zero a parameter has the value
    (L_ff)^-1 L_f: change, L the information.
    """
    information = np.linalg.inv(covariance)
    groups = list(_PARAMETERS)
    while groups:
        free = np.r_[tuple(groups)]
        left = np.linalg.inv(information[np.ix_(free, free)])
        value = np.zeros(LENS)
        value[free] = left @ (information[free] @ change)
        whole = np.zeros((LENS, LENS))
        whole[np.ix_(free, free)] = left
        chance = [chdtrc(own.stop - own.start,
                         value[own] @ np.linalg.solve(whole[own, own], value[own]))
                  for own in groups]
        worst = int(np.argmax(chance))
        if chance[worst] < _SIGNIFICANCE:
            return value
        del groups[worst]
    return np.zeros(LENS)

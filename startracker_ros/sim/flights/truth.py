# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The truth of a flight at any time, in closed form: pieces can be made side by side."""

from dataclasses import dataclass
from functools import cached_property
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import (
    ARCSEC, conjugate, matrix_from_quaternion, multiply, quaternion_from_axes,
    quaternion_from_rotation_vector, rotation_vector_from_quaternion)
from startracker_ros.sim.flights.options import FlightOptions

_ALTITUDE_M = 600e3
_INCLINATION_RAD, _NODE_RAD = np.radians([97.8, 40.0])
_TILT_DEG = 35.0
_WOBBLE = ((20.0, 0.31, (1.0, 0.2, -0.4)), (8.0, 0.083, (-0.3, 1.0, 0.5)),
           (40.0, 0.011, (0.4, -0.6, 1.0)))
"""Attitude errors of the body: amplitude in arcsec, frequency in rad/s, axis."""
_BIAS_KNOT_S = 600.0


_OBJECT_RATES_DEG_S = (0.01, 0.5)
_OBJECT_S = 120.0


class MovingObjects(NamedTuple):
    """
    Objects on great circles: at direction (N, 3) at time_s (N,), with rate_rad_s (N,).

    heading (N, 3) is the unit vector across the direction into which they move.
    """

    time_s: np.ndarray
    direction: np.ndarray
    heading: np.ndarray
    rate_rad_s: np.ndarray

    def near(self, begin_s: float, end_s: float) -> 'MovingObjects':
        """Return those that are seen between two times: within two minutes of time_s."""
        chosen = slice(*np.searchsorted(self.time_s, [begin_s - _OBJECT_S, end_s + _OBJECT_S]))
        return MovingObjects(*(column[chosen] for column in self))

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Return their directions (F, N, 3) at times (F,)."""
        angle = ((time_s[:, None] - self.time_s) * self.rate_rad_s)[..., None]
        return np.cos(angle) * self.direction + np.sin(angle) * self.heading


@dataclass(frozen=True)
class Truth:
    """Attitudes, mounts, focal lengths and gyro biases at times (F,) in s since the begin."""

    options: FlightOptions
    seed: int

    @cached_property
    def orbit(self) -> CircularOrbit:
        """The orbit of the spacecraft, argument of latitude 0 at the begin."""
        return CircularOrbit(EARTH_RADIUS_M + _ALTITUDE_M, _INCLINATION_RAD, _NODE_RAD, 0.0)

    @cached_property
    def camera(self) -> Camera:
        """The camera that both heads are calibrated as."""
        width = self.options.width_px
        return Camera.from_fov(width, width, self.options.fov_deg)

    def stamps_ns(self, time_s: np.ndarray) -> np.ndarray:
        """Return the stamps of times."""
        return round(self.options.start_utc_s * 1e9) + np.rint(time_s * 1e9).astype(np.int64)

    def attitude(self, head: int, time_s: np.ndarray) -> np.ndarray:
        """Return q_icrf_from_sensor (F, 4) of a head, 0 or 1."""
        position_m = self.orbit.at(0.0)[0]
        zenith = position_m / np.linalg.norm(position_m)
        # z to the zenith, y along the orbit normal: the body turns about y.
        begin = quaternion_from_axes(zenith, self.orbit.normal)
        turn = np.zeros((len(time_s), 3))
        turn[:, 1] = time_s * self.orbit.rate_rad_s
        body = multiply(begin, quaternion_from_rotation_vector(turn))
        wobble = sum(amplitude * ARCSEC * np.sin(frequency * time_s)[:, None] * np.array(axis)
                     for amplitude, frequency, axis in _WOBBLE)
        body = multiply(body, quaternion_from_rotation_vector(wobble))
        mount = multiply(self._nominal(head),
                         quaternion_from_rotation_vector(self.mount_rad(head, time_s)))
        q = multiply(body, mount)
        return q / np.linalg.norm(q, axis=-1, keepdims=True)

    @staticmethod
    def _nominal(head: int) -> np.ndarray:
        """Return q_body_from_sensor (4,): tilted to the two sides of the zenith."""
        side = np.radians(_TILT_DEG) * (1 if head else -1)
        return multiply(quaternion_from_rotation_vector([side, 0.0, 0.0]),
                        quaternion_from_rotation_vector([0.0, 0.0, 0.4 + head]))

    def mount_rad(self, head: int, time_s: np.ndarray) -> np.ndarray:
        """Return how far a mount is turned (F, 3) about the axes of the head."""
        options, turn = self.options, np.zeros((len(time_s), 3))
        if head:
            turn[:, 0] = ARCSEC * (
                options.mount_drift_arcsec_day * time_s / 86400
                + options.mount_orbit_arcsec * np.sin(self.orbit.rate_rad_s * time_s)
                + options.mount_step_arcsec * (time_s >= options.mount_step_day * 86400))
        return turn

    def focal_ratio(self, head: int, time_s: np.ndarray) -> np.ndarray:
        """Return the focal lengths (F,) over those of the camera."""
        options = self.options
        if head:
            return np.ones(len(time_s))
        return 1 + 0.01 * (
            options.focal_drift_percent_day * time_s / 86400
            + options.focal_orbit_percent * np.cos(self.orbit.rate_rad_s * time_s)
            + options.focal_step_percent * (time_s >= options.focal_step_day * 86400))

    def objects(self, head: int) -> 'MovingObjects':
        """Return the moving objects that a head sees."""
        return self._objects[head]

    @cached_property
    def _objects(self) -> 'list[MovingObjects]':
        options, found = self.options, []
        slowest, fastest = map(math.log, _OBJECT_RATES_DEG_S)
        for head in range(options.heads):
            rng = np.random.default_rng([self.seed, 2_000_000, head])
            count = rng.poisson(options.objects_hour * options.days * 24)
            time_s = np.sort(rng.uniform(0, options.days * 86400, count))
            middle = self.camera.unproject(rng.uniform(0.25, 0.75, (count, 2))
                                           * options.width_px)
            direction = np.einsum('nij,nj->ni', matrix_from_quaternion(
                self.attitude(head, time_s)), middle)
            heading = np.cross(direction, rng.standard_normal((count, 3)))
            heading /= np.linalg.norm(heading, axis=1, keepdims=True)
            found.append(MovingObjects(time_s, direction, heading, np.radians(np.exp(
                rng.uniform(slowest, fastest, count)))))
        return found

    def hot_pixels(self, head: int) -> np.ndarray:
        """Return the hot pixels (N, 2) of a head."""
        rng = np.random.default_rng([self.seed, 3_000_000, head])
        return rng.integers(0, self.options.width_px, (self.options.hot_pixels, 2)).astype(float)

    def rate_rad_s(self, head: int, time_s: np.ndarray, interval_s: float) -> np.ndarray:
        """Return the mean body rates (F, 3) over the intervals before times."""
        turn = multiply(conjugate(self.attitude(head, time_s - interval_s)),
                        self.attitude(head, time_s))
        return rotation_vector_from_quaternion(turn) / interval_s

    def gyro_bias_rad_s(self, head: int, time_s: np.ndarray) -> np.ndarray:
        """Return the biases (F, 3): a random walk in steps of ten minutes."""
        knots_s, bias = self._bias[head]
        return np.column_stack([np.interp(time_s, knots_s, column) for column in bias.T])

    @cached_property
    def _bias(self) -> list[tuple[np.ndarray, np.ndarray]]:
        options, deg_h = self.options, np.radians(1 / 3600)
        count = int(options.days * 86400 / _BIAS_KNOT_S) + 2
        found = []
        for head in range(options.heads):
            rng = np.random.default_rng([self.seed, 1_000_000, head])
            steps = rng.standard_normal((count, 3)) * (
                options.gyro_walk_deg_h_sqrt_h * np.sqrt(_BIAS_KNOT_S / 3600))
            steps[0] = rng.standard_normal(3) * options.gyro_bias_deg_h
            found.append((np.arange(count) * _BIAS_KNOT_S, np.cumsum(steps, axis=0) * deg_h))
        return found

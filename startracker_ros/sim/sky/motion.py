# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""True attitude, rate, position and velocity of a simulated sensor."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.maths.rotation import (
    ARCSEC, conjugate, multiply, quaternion_from_pointing, quaternion_from_rotation_vector, rotate)
from startracker_ros.core.options import option, Options
from startracker_ros.sim.sky.motion_state import Motion, MotionState
from startracker_ros.sim.sky.mounted import HeadOptions, mounted
from startracker_ros.sim.sky.shake import ShakenMotion


@dataclass(frozen=True)
class SteadyMotion:
    """
    Rotation at a constant rate about a fixed axis, along an orbit.

    q_start (4,) is q_icrf_from_sensor at time 0, rate_rad_s (3,) is on sensor axes.
    """

    q_start: np.ndarray
    rate_rad_s: np.ndarray
    orbit: CircularOrbit

    def at(self, time_s: float) -> MotionState:
        """Return the state; q(t) = q(0) exp(rate t) is continuous, without sign jumps."""
        turn = quaternion_from_rotation_vector(self.rate_rad_s * time_s)
        position_m, velocity_m_s = self.orbit.at(time_s)
        return MotionState(multiply(self.q_start, turn), self.rate_rad_s, position_m, velocity_m_s)


@dataclass(frozen=True)
class RollJitter:
    """
    A steady motion with a random roll about the boresight added, from time 0 on.

    The jitter of Sadeghi, Sabahi and Saberali: the roll rate is uniform in +-peak_rad_s and
    constant over each block, so the roll angle is continuous.
    """

    steady: Motion
    peak_rad_s: float
    block_s: float
    seed: int

    def at(self, time_s: float) -> MotionState:
        """Return the state; draws all blocks up to time_s, 1 us for a hundred blocks."""
        block, within = divmod(max(time_s, 0.0) / self.block_s, 1)
        rate_rad_s = np.random.default_rng(self.seed).uniform(
            -self.peak_rad_s, self.peak_rad_s, int(block) + 1)
        angle = self.block_s * (rate_rad_s[:-1].sum() + within * rate_rad_s[-1])
        roll = quaternion_from_rotation_vector([0.0, 0.0, angle])
        return self.steady.at(time_s).turned(
            roll, [0.0, 0.0, rate_rad_s[-1] if time_s >= 0 else 0.0])


@dataclass(frozen=True)
class MotionOptions(Options):
    """Pointing at time 0, the motion, and the orbit."""

    motion: str = option(
        'low_earth_orbit',
        'inertial: fixed attitude; constant_rate: rotates at rate_deg_s; '
        'low_earth_orbit: fixed in the orbit frame, one rotation per revolution; '
        'topic: that of motion/odometry',
        choices=('inertial', 'constant_rate', 'low_earth_orbit', 'topic'))
    ra_deg: float = option(84.0, 'right ascension of the boresight at time 0', unit='deg',
                           low=-360.0, high=360.0)
    dec_deg: float = option(0.0, 'declination of the boresight at time 0', unit='deg',
                            low=-90.0, high=90.0)
    roll_deg: float = option(
        0.0, 'position angle of image up at time 0, from celestial north through east',
        unit='deg', low=-360.0, high=360.0)
    rate_deg_s: tuple[float, float, float] = option(
        (0.0, 0.06, 0.0), 'angular velocity about sensor x, y, z for constant_rate',
        unit='deg/s', low=-20.0, high=20.0)
    jitter_deg_s: float = option(
        0.0, 'largest rate of a random roll about the boresight: uniform in +-jitter_deg_s, '
        'constant over blocks', unit='deg/s', low=0.0, high=20.0)
    jitter_block_s: float = option(1.0, 'length of a block of constant roll rate', unit='s',
                                   low=0.01, high=1000.0)
    vibration_arcsec: float = option(
        0.0, 'amplitude of a sinusoidal vibration about an axis across the boresight; it blurs '
        'stars with motion_smear', unit='arcsec', low=0.0, high=3600.0)
    vibration_hz: float = option(7.3, 'frequency of the vibration', unit='Hz', low=0.01,
                                 high=1000.0)
    kick_arcsec: float = option(
        0.0, 'sudden jumps of the pointing: one in each kick_period_s, at a random instant of it '
        'and in a random direction; every second one leads back', unit='arcsec', low=0.0,
        high=3600.0)
    kick_period_s: float = option(0.15, 'mean time between two kicks', unit='s', low=0.001,
                                  high=1000.0)
    altitude_km: float = option(700.0, 'altitude of the circular orbit, above the equatorial '
                                'radius', unit='km', low=160.0, high=100000.0)
    inclination_deg: float = option(30.0, 'inclination of the orbit to the ICRF equator',
                                    unit='deg', low=0.0, high=180.0)
    node_deg: float = option(0.0, 'right ascension of the ascending node', unit='deg',
                             low=-360.0, high=360.0)
    latitude_deg: float = option(0.0, 'argument of latitude at time 0, from the ascending node',
                                 unit='deg', low=-360.0, high=360.0)

    @property
    def orbit(self) -> CircularOrbit:
        """Return the orbit."""
        return CircularOrbit(EARTH_RADIUS_M + 1e3 * self.altitude_km, *np.radians(
            [self.inclination_deg, self.node_deg, self.latitude_deg]))


def motion_from_options(options: MotionOptions = MotionOptions(), *, seed: int = 0,
                        head: HeadOptions = HeadOptions()) -> Motion:
    """
    Return the motion of a head by the options, other than topic.

    seed is that of jitter and shake, which are of the sensor, not of the body.
    """
    orbit = options.orbit
    q_start = quaternion_from_pointing(
        *np.radians([options.ra_deg, options.dec_deg, options.roll_deg]))
    if options.motion == 'inertial':
        rate_rad_s = np.zeros(3)
    elif options.motion == 'constant_rate':
        rate_rad_s = np.radians(options.rate_deg_s)
    else:
        # The orbit frame rotates about the orbit normal, which is fixed on the axes of a sensor
        # that is fixed in the orbit frame: a constant rate on sensor axes.
        rate_rad_s = rotate(conjugate(q_start), orbit.rate_rad_s * orbit.normal)
    motion: Motion = mounted(SteadyMotion(q_start, rate_rad_s, orbit), head)
    if options.jitter_deg_s:
        motion = RollJitter(
            motion, np.radians(options.jitter_deg_s), options.jitter_block_s, seed)
    if options.vibration_arcsec or options.kick_arcsec:
        motion = ShakenMotion(
            motion, options.vibration_arcsec * ARCSEC, options.vibration_hz,
            options.kick_arcsec * ARCSEC, options.kick_period_s, seed)
    return motion

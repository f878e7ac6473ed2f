# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a long flight is made of."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from startracker_ros.core.options import option, Options
from startracker_ros.core.yaml_text import load_yaml

_BRIGHTEST_ERROR = 0.2


@dataclass(frozen=True)
class FlightOptions(Options):
    """Two heads on a body that turns with its orbit; what drifts, and what steps."""

    days: float = option(1.0, 'length of the flight', unit='d', low=0.001, high=3660.0)
    rate_hz: float = option(1.0, 'frames and gyro rates a second', unit='Hz', low=1.0, high=10.0)
    start_utc_s: float = option(
        1_767_225_600.0, 'UNIX time of the begin, 2026-01-01T00:00:00', unit='s', low=0.0,
        high=4e9)
    bag_hours: float = option(6.0, 'length of a bag', unit='h', low=0.01, high=1000.0)
    heads: int = option(2, 'star tracker heads', low=1, high=2)
    fov_deg: float = option(12.0, 'horizontal field of view', unit='deg', low=5.0, high=40.0)
    width_px: int = option(1024, 'width and height of the image', unit='px', low=64, high=8192)
    magnitude_limit: float = option(6.0, 'faintest stars seen, V', unit='mag', low=3.0, high=9.0)
    sigma_px: float = option(
        0.1, 'error of the centroid of a star of magnitude_limit per axis, 1 sigma; brighter '
        'stars have less, down to a fifth', unit='px', low=0.001, high=2.0)
    missing: float = option(0.02, 'probability that a star is not seen', low=0.0, high=0.9)
    false: float = option(0.5, 'false centroids in a frame, mean', low=0.0, high=100.0)
    objects_hour: float = option(
        0.0, 'moving objects that pass the middle of the field of each head in an hour, mean',
        low=0.0, high=10_000.0)
    object_snr: float = option(7.0, 'their SNR; a star of magnitude_limit has 1 / sigma_px',
                               low=3.0, high=1000.0)
    hot_pixels: int = option(0, 'hot pixels of each head', low=0, high=1000)
    gyro_bias_deg_h: float = option(
        1.0, 'bias of the gyro about each axis, 1 sigma', unit='deg/h', low=0.0, high=1000.0)
    gyro_walk_deg_h_sqrt_h: float = option(
        0.05, 'random walk of that bias', unit='deg/h/sqrt(h)', low=0.0, high=100.0)
    gyro_noise_deg_sqrt_h: float = option(
        0.15, 'white noise of the gyro', unit='deg/sqrt(h)', low=0.0, high=100.0)
    mount_drift_arcsec_day: float = option(
        0.02, 'drift of the mount of the second head about its x axis', unit='arcsec/d',
        low=-100.0, high=100.0)
    mount_orbit_arcsec: float = option(
        0.3, 'amplitude of its motion with the heat of each orbit', unit='arcsec', low=0.0,
        high=100.0)
    mount_step_arcsec: float = option(
        0.0, 'step of that mount about x', unit='arcsec', low=-3600.0, high=3600.0)
    mount_step_day: float = option(0.0, 'when', unit='d', low=0.0, high=3660.0)
    focal_drift_percent_day: float = option(
        1e-5, 'drift of the focal length of the first head', unit='%/d', low=-1.0, high=1.0)
    focal_orbit_percent: float = option(
        0.0005, 'amplitude of its change in each orbit', unit='%', low=0.0, high=1.0)
    focal_step_percent: float = option(
        0.0, 'step of that focal length', unit='%', low=-1.0, high=1.0)
    focal_step_day: float = option(0.0, 'when', unit='d', low=0.0, high=3660.0)

    def centroid_sigma_px(self, magnitude: np.ndarray) -> np.ndarray:
        """Return the 1 sigma errors (N,) of the centroids of stars (N,), per axis."""
        return self.sigma_px * np.maximum(
            10 ** (0.2 * (magnitude - self.magnitude_limit)), _BRIGHTEST_ERROR)


def flight_options(settings: Iterable[str]) -> FlightOptions:
    """Return the options of NAME=VALUE texts; ValueError names what is wrong."""
    known = {row.name for row in FlightOptions.table()}
    values = {}
    for text in settings:
        name, _, value = text.partition('=')
        if name not in known:
            raise ValueError(f'no option {name!r}; there are {", ".join(sorted(known))}')
        values[name] = load_yaml(value)
    return FlightOptions(**values)

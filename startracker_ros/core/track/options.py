# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Options of the star tracker."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.attitude.result import SOLVERS
from startracker_ros.core.catalog.deep import DEEP_LIMIT
from startracker_ros.core.options import option, Options
from startracker_ros.core.registry import MODELS

ASSOCIATIONS = ('poisson', 'diffuse', 'normalised')
"""
Factors of phi false centroids in a joint event: lambda^phi of a Poisson process of density lambda;
phi! / V^phi of a density that is not known, with the area V of all gates; or none, where the
matrix of all sums is normalised by rows and columns at once.
"""


@dataclass(frozen=True)
class TrackerOptions(Options):
    """The motion model, the association, and the limits of the state machine."""

    model: str = option(
        'attitude', 'attitude: one rotation moves all stars; constant_velocity and '
        'coordinated_turn: a filter for each star (JPDAF); sna: no filter, each star where it '
        'was measured (star neighbourhood approach)', choices=tuple(MODELS))
    solver: str = option(
        'quest', 'solver of the attitude, of all models but attitude: quest, davenport and svd '
        'find the same best fit of all stars, triad takes the two that determine it best',
        choices=SOLVERS)
    association: str = option(
        'poisson', 'false centroids in the joint events, of constant_velocity and '
        'coordinated_turn: poisson, with the density of those in no gate; diffuse, of unknown '
        'density (phi! / V^phi); normalised, without such a factor', choices=ASSOCIATIONS)
    sna_confirmation: bool = option(
        False, 'associate only centroids that the star neighbourhood approach confirms, of '
        'constant_velocity and coordinated_turn')
    roll_by_gyro: bool = option(
        False, 'predict the roll of the image by imu, of constant_velocity and '
        'coordinated_turn: jitter about the boresight is measured and no noise')
    magnitude_limit: float = option(
        DEEP_LIMIT, 'faintest catalogue stars that are followed, V; beyond 9 only fields below '
        '4 deg have stars', unit='mag', low=0.0, high=DEEP_LIMIT)
    max_stars: int = option(
        40, 'most stars followed at a time, brightest first', low=4, high=500, live=True)
    min_stars: int = option(
        4, 'fewest stars that must be seen and move as one for a frame to count as good',
        low=3, high=100, live=True)
    acceleration_deg_s2: float = option(
        0.005, 'process noise, 1 sigma of the angular acceleration; more follows manoeuvres '
        'faster, less filters better', unit='deg/s^2', low=1e-6, high=100.0)
    roll_acceleration_deg_s2: float = option(
        0.005, 'the same about the boresight: a camera that shakes in roll keeps its boresight '
        'filtered', unit='deg/s^2', low=1e-6, high=100.0)
    sigma_floor_px: float = option(
        0.01, 'lower limit of the 1-sigma error of a centroid per axis', unit='px',
        low=1e-4, high=10.0, live=True)
    detection_probability: float = option(
        0.95, 'how often a followed star is among the centroids', low=0.01, high=0.999)
    gate_probability: float = option(
        0.9999, 'how often the centroid of a star is inside its gate', low=0.5, high=0.999999)
    max_missed: int = option(
        5, 'frames in a row without a centroid after which a star is dropped, unless the whole '
        'image is dark', unit='frames', low=0, high=200, live=True)
    confirm_frames: int = option(
        3, 'frames after which a newly found star counts if it was missed in no more than half of '
        'them, and frames in a row in which a gyro must agree with the stars before it is used',
        unit='frames', low=1, high=100, live=True)
    magnitude_tolerance: float = option(
        1.0, 'largest difference of brightness between a newly found star and the catalogue',
        unit='mag', low=0.05, high=20.0, live=True)
    max_residual_px: float = option(
        1.0, 'largest rms residual of the stars of a good frame, measured minus catalogue; raise '
        'it for a lens that is not calibrated', unit='px', low=0.01, high=100.0, live=True)
    max_bad_frames: int = option(
        5, 'frames in a row with stars other than those followed, after which the tracker is lost',
        unit='frames', low=1, high=1000, live=True)
    max_rate_deg_s: float = option(
        10.0, 'fastest turn accepted between two identifications', unit='deg/s', low=0.001,
        high=100.0, live=True)
    max_gap_s: float = option(
        5.0, 'longest time without stars that is bridged, and longest between the two '
        'identifications of a start', unit='s', low=0.01, high=600.0, live=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.changed:
            models = [model for model, registered in MODELS.items() if name in registered.options]
            if models and self.model not in models:
                raise ValueError(
                    f'{name} = {getattr(self, name)!r} has no effect with model = '
                    f'{self.model!r}: it is an option of {", ".join(models)}')

    @property
    def ignored(self) -> list[str]:
        """Return the options that are not the default and have no effect without a filter."""
        return [name for name in self.changed if name in MODELS[self.model].ignored]

    @property
    def acceleration_rad_s2(self) -> np.ndarray:
        """Return the 1 sigma (3,) of the angular acceleration about sensor axes."""
        across, roll = self.acceleration_deg_s2, self.roll_acceleration_deg_s2
        return np.radians([across, across, roll])

    @property
    def reads_gyro(self) -> bool:
        """Return whether the rates of a gyro have an effect."""
        return self.model == 'attitude' or self.roll_by_gyro

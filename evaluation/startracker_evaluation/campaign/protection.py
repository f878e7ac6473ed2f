# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How often an error exceeds its protection level: rare events, by importance sampling."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core.integrity.protection import protection_level, ProtectionOptions
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.rows import Row

OUTLIER_SIGMAS = 5.0
"""A star that is further from where the others have it is rejected."""

_HALF_FIELD_RAD = np.radians(6.0)
_STARS = (8, 14, 30)
_BIASES_SIGMA = (2.0, 5.0, 8.0, 12.0)


class Found(NamedTuple):
    """A probability and its standard error."""

    probability: float
    error: float


def probability_of(event: Callable[[np.ndarray], np.ndarray], shifts: np.ndarray, draws: int,
                   rng: np.random.Generator) -> Found:
    """
    Return the probability that event(n), a mask (M,) of values n ~ N(0, I) (M, D), is true.

    Values are drawn from the mixture of N(m_k, I), k = 1 .. K of equal shares, with shifts m_k
    (K, D) that lead into the event, and each counts with the ratio of the densities,
    w = K / sum_k exp(m_k n - m_k^2 / 2) (Owen and Zhou, J. Amer. Stat. Assoc. 95, 2000). The shift
    zero should be among them where the event has parts that the others do not show: then no
    weight exceeds K.
    """
    count, size = shifts.shape
    n = rng.standard_normal((draws, size)) + shifts[rng.integers(count, size=draws)]
    exponents = n @ shifts.T - np.sum(shifts ** 2, axis=1) / 2
    largest = exponents.max(axis=1)
    mixture = np.exp(exponents - largest[:, None]).mean(axis=1)
    weighted = np.where(event(n), np.exp(-largest) / mixture, 0.0)
    return Found(float(weighted.mean()), float(weighted.std(ddof=1) / np.sqrt(draws)))


@dataclass(frozen=True)
class Field:
    """Stars (N,) of one image: unit vectors sensor (N, 3) and the errors sigma_rad (N,)."""

    sensor: np.ndarray
    sigma_rad: np.ndarray

    @classmethod
    def random(cls, stars: int, rng: np.random.Generator) -> 'Field':
        """Return stars at random places, with errors of 1 to 8 arcsec."""
        xy = rng.uniform(-_HALF_FIELD_RAD, _HALF_FIELD_RAD, (stars, 2))
        sensor = np.column_stack([xy, np.ones(stars)])
        return cls(sensor / np.linalg.norm(sensor, axis=1, keepdims=True),
                   ARCSEC * np.exp(rng.uniform(0, np.log(8.0), stars)))

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (3, 3) of the best fit."""
        return np.linalg.inv(np.einsum('nki,nkj->ij', self.design, self.design))

    @property
    def design(self) -> np.ndarray:
        """Return how a turn moves each star across the line of sight, in sigma: (N, 2, 3)."""
        across = np.cross(self.sensor, [0.0, 1.0, 0.0])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        axes = np.stack([across, np.cross(self.sensor, across)], axis=1)
        # A turn x of the sensor moves p by p x x; its component along e is x . (e x p).
        return np.cross(axes, self.sensor[:, None]) / self.sigma_rad[:, None, None]

    def arguments(self, residual_rad: np.ndarray) -> dict[str, Any]:
        """Return what protection_level() needs of the best fit with residuals (N,)."""
        return {'covariance': self.covariance, 'sensor': self.sensor,
                'sigma_rad': self.sigma_rad, 'residual_rad': residual_rad}


def exceedance(field: Field, options: ProtectionOptions, *, false: bool, draws: int,
               rng: np.random.Generator) -> Found:
    """
    Return the probability that the error of the worst axis exceeds its level.

    With false, one star is false, which has the probability that the options state of each: it is
    shifted along a random direction by the worst of some biases, and the frame does not count
    where it is found, by OUTLIER_SIGMAS. Otherwise there is no false star.
    """
    if not false:
        return _exceedance(field, options, np.zeros(2 * len(field.sensor)), draws, rng)
    worst = Found(0.0, 0.0)
    for star in range(len(field.sensor)):
        angle = rng.uniform(0, 2 * np.pi)
        found = []
        for size in _BIASES_SIGMA:
            bias = np.zeros((len(field.sensor), 2))
            bias[star] = size * np.cos(angle), size * np.sin(angle)
            found.append(_exceedance(field, options, bias.ravel(), draws // len(_BIASES_SIGMA),
                                     rng))
        largest = max(found)
        # The stars exclude each other: their probabilities add up.
        worst = Found(worst.probability + options.false_star_probability * largest.probability,
                      float(np.hypot(worst.error, options.false_star_probability
                                     * largest.error)))
    return worst


def _exceedance(field: Field, options: ProtectionOptions, bias: np.ndarray, draws: int,
                rng: np.random.Generator) -> Found:
    """Return the largest probability of the axes, with a bias (2 N,) of the stars in sigma."""
    design = field.design.reshape(-1, 3)
    gain = field.covariance @ design.T  # from errors in sigma to the turn
    level = protection_level(**field.arguments(np.zeros(len(field.sensor))), options=options)
    found = []
    for axis in range(3):
        row = gain[axis]
        # The nearest errors that make the turn as large as the level without any residual.
        shifts = np.array([(side * level[axis] - row @ bias) * row / (row @ row)
                           for side in (-1.0, 1.0)] + [np.zeros(len(row))])

        def exceeds(n: np.ndarray, axis: int = axis) -> np.ndarray:
            errors = n + bias
            turn = errors @ gain.T
            large = np.flatnonzero(np.abs(turn[:, axis]) > level[axis])
            exceeded = np.zeros(len(n), bool)
            left = errors[large] - turn[large] @ design.T
            distance = np.linalg.norm(left.reshape(len(large), -1, 2), axis=2)
            for k, away in zip(large, distance):
                own = protection_level(**field.arguments(away * field.sigma_rad),
                                       options=options)
                exceeded[k] = (away.max() <= OUTLIER_SIGMAS
                               and abs(turn[k, axis]) > own[axis])
            return exceeded
        found.append(probability_of(exceeds, shifts, draws, rng))
    return max(found)


def run_protection_campaign(*, trials: int, seed: int) -> Result:
    """Draw so many errors of each field and hypothesis."""
    rng, rows = np.random.default_rng(seed), []
    for stars in _STARS:
        field, options = Field.random(stars, rng), ProtectionOptions()
        stated = options.misleading_probability
        level = protection_level(**field.arguments(np.zeros(stars)))
        for axis, value, sigma in zip('xyz', level, np.sqrt(np.diag(field.covariance))):
            rows.append(Row(f'{stars} stars: level over sigma, {axis}', value / sigma, ''))
        for name, false in (('no star is false', False), ('one star is false', True)):
            found = exceedance(field, options, false=false, draws=trials, rng=rng)
            rows.append(Row(f'{stars} stars, {name}: level exceeded', found.probability, '',
                            most=stated))
            rows.append(Row(f'{stars} stars, {name}: standard error', found.error, ''))
    return Result('campaign protection', rows, {
        'fields': 'stars at random places of 12 deg, errors of 1 to 8 arcsec',
        'level exceeded': 'probability of a frame, of the worst axis; with a false star summed '
                          'over the stars, each with the probability of its parameter and the '
                          'worst of four shifts',
        'method': 'importance sampling', 'trials': trials, 'seed': seed})

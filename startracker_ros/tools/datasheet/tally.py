# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera of the integrity campaign, and the count of what its runs publish."""

from dataclasses import dataclass, field, fields, replace
from functools import partial

import numpy as np
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.frame_result import Attitude, FrameResult
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.tools.figures.correctness import count_wrong

CAMERA = Camera.from_fov(1024, 1024, 12.0)
EPOCH_YEAR = 2026.5
STEP_NS = 100_000_000
START_NS = stamp_from_epoch_year(EPOCH_YEAR)


_BINS_PER_OCTAVE, _BINS = 4, 120
_LEAST_SIGMA = 1e-3 * ARCSEC


@dataclass(frozen=True)
class Tally:
    """
    Counts of one run or of many.

    due counts the frames that need an attitude, available those of them that have one. Of the
    published attitudes: worst_sigma is the largest error in standard deviations of its own
    covariance on any axis, nees and square_arcsec2 (boresight) are sums. Of the rates published
    with them rates_wrong are beyond 5 sigma, rates_nees is a sum; at, at_wrong and at_nees are the
    same of Attitude.at() at other times. by_sigma (K, 2) are the counts and the sums of NEES of
    the attitudes by their boresight sigma, four bins in each factor of two.
    """

    frames: int = 0
    due: int = 0
    available: int = 0
    published: int = 0
    wrong: int = 0
    gross: int = 0
    losses: int = 0
    nees: float = 0.0
    square_arcsec2: float = 0.0
    worst_sigma: float = 0.0
    rates_wrong: int = 0
    rates_nees: float = 0.0
    at: int = 0
    at_wrong: int = 0
    at_nees: float = 0.0
    by_sigma: np.ndarray = field(
        default_factory=partial(np.zeros, (_BINS, 2)), repr=False, compare=False)

    def __add__(self, other: 'Tally') -> 'Tally':
        both = Tally(*(getattr(self, one.name) + getattr(other, one.name)
                       for one in fields(Tally)))
        return replace(both, worst_sigma=max(self.worst_sigma, other.worst_sigma))

    @property
    def worst(self) -> float:
        """Largest error over its bound, wrong above 1."""
        return self.worst_sigma / WRONG_SIGMAS

    def nees_by_quarter(self) -> tuple[float, ...]:
        """
        Return the mean NEES of each quarter of the attitudes, the least sigma first.

        The mean of all hides a sigma that is too large in some frames.
        """
        count, nees = self.by_sigma.T
        limits = np.linspace(0, count.sum(), 5)
        sums = np.interp(limits, np.append(0, np.cumsum(count)), np.append(0, np.cumsum(nees)))
        return tuple((np.diff(sums) / np.diff(limits)).tolist()) if count.any() else ()


def tally_of_rate(rate_rad_s: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> Tally:
    """Return the tally of the rate (3,) of an attitude, covariance (3, 3) about sensor axes."""
    error = rate_rad_s - truth
    return Tally(rates_wrong=count_wrong(error, np.sqrt(np.diag(covariance))).wrong,
                 rates_nees=float(error @ np.linalg.solve(covariance, error)))


def tally_of(quaternion: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> Tally:
    """Return the tally of one published attitude (4,), covariance (3, 3) about sensor axes."""
    error, sigma = attitude_error(quaternion, truth), np.sqrt(np.diag(covariance))
    nees, by_sigma = float(error @ np.linalg.solve(covariance, error)), np.zeros((_BINS, 2))
    octaves = np.log2(np.sqrt(sigma[0] * sigma[1]) / _LEAST_SIGMA)
    by_sigma[int(np.clip(_BINS_PER_OCTAVE * octaves, 0, _BINS - 1))] = 1, nees
    return Tally(published=1, **count_wrong(error, sigma)._asdict(), nees=nees, by_sigma=by_sigma,
                 square_arcsec2=float(error[:2] @ error[:2]) / ARCSEC ** 2,
                 worst_sigma=float(np.max(np.abs(error) / sigma)))


def tally_of_other_times(attitude: Attitude | None, truths: dict[float, np.ndarray]) -> Tally:
    """Return the tally of at(), by the true attitude (4,) at times in s after the frame."""
    tally = Tally()
    if attitude is None:
        return tally
    for after_s, truth in truths.items():
        one = attitude.at(attitude.stamp_ns + round(after_s * 1e9))
        found = tally_of(one.quaternion, one.covariance_sensor, truth)
        tally += Tally(at=1, at_wrong=found.wrong, at_nees=found.nees)
    return tally


def tally_of_frame(frame: FrameResult, before: TrackerState, truth: np.ndarray,
                   rate_rad_s: np.ndarray, due: bool = True) -> Tally:
    """
    Return the tally of a frame; before is the state of the tracker before it.

    truth (4,) and rate_rad_s (3,) are the true attitude and rate at its stamp.
    """
    attitude = frame.attitude
    lost = before is TrackerState.TRACKING and frame.state is not before
    tally = Tally(frames=1, due=int(due), available=int(due and attitude is not None),
                  losses=int(lost))
    if attitude is None:
        return tally
    return (tally + tally_of(attitude.quaternion, attitude.covariance_sensor, truth)
            + tally_of_rate(attitude.rate_rad_s, attitude.rate_covariance, rate_rad_s))

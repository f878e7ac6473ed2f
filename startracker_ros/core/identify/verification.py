# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Verification of a candidate attitude by all stars of the field: by the native library.

native/src/identify/verification.h tells how: an attitude and a focal length fit the candidate, all
image stars are associated with the catalogue, and the false-alarm probability is that of so good
an agreement by chance.
"""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.attitude.result import AttitudeEstimate
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.identify.star_matcher import Rules, StarMatcher, Verified

MAX_VERIFIED = 5
"""Candidates of one pattern that are verified, those with the most support."""

_MOST_STARS = 500  # of max_image_stars


@dataclass(frozen=True)
class Match:
    """
    A verified or rejected candidate.

    star (N,) is the catalogue index of each image star, -1 for none; residual_px (N,) the
    distance to it, NaN for none; attitude None for a rejected one.
    """

    star: np.ndarray
    residual_px: np.ndarray
    attitude: AttitudeEstimate | None
    focal_ratio: float
    false_alarm: float

    @property
    def matched(self) -> int:
        """Return the number of matched stars."""
        return int(np.count_nonzero(self.star >= 0))


class Verifier:
    """
    Verifies candidates against one catalogue and one camera.

    Where bases_by_brightness, the stars of a candidate were chosen by their brightness, which is
    then no evidence for them. lens_known is False for a lens that is fitted after the
    identification: its near misses are then expected.
    """

    def __init__(self, camera: Camera, onboard: OnboardCatalog, tolerance_sigmas: float,
                 scale_error: float, *, bases_by_brightness: bool = False,
                 lens_known: bool = True) -> None:
        self._matcher = StarMatcher(
            camera, onboard,
            {'tolerance_sigmas': tolerance_sigmas, 'max_image_stars': _MOST_STARS},
            Rules(scale_error, bases_by_brightness, lens_known))

    def supported(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
                  stars: np.ndarray) -> np.ndarray:
        """
        Return the candidates (K,) that further image stars support, the best first.

        image (N, 3) are the image stars, base (B,) those of the pattern, stars (M, B) the
        catalogue stars that they may be.
        """
        found = self._matcher.support(image, sigma_rad, base[:3], stars[:, :3])
        order = np.argsort(-found, kind='stable')[:MAX_VERIFIED]
        # Candidates with a third of the support of the best one or less are chance.
        return order[found[order] > found[order[0]] / 3] if len(order) else order

    def verify(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
               star: np.ndarray, tested: int) -> Match:
        """
        Return how well the field fits when image stars base (B,) are the stars star (B,).

        image (N, 3) and sigma_rad (N,) are those of all image stars; tested is the number of
        candidates so far.
        """
        return _match(self._matcher.verify(image, sigma_rad, base, star, tested))

    def few_stars(self, image: np.ndarray, sigma_rad: np.ndarray, table: np.ndarray,
                  false_alarm_max: float, work_s: float) -> tuple[Match, float]:
        """
        Return the best of the triangles of a table among a few stars and many false spots.

        image (N, 3) and sigma_rad (N,) are those of all image stars, table is an
        st_triangle_table. The first one below false_alarm_max ends the search, or so much work;
        the second result is what it took.
        """
        found, spent_s = self._matcher.few_stars(
            image, sigma_rad, table, false_alarm_max, work_s)
        return _match(found), spent_s

    def best_of_quads(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
                      star: np.ndarray, least_support: float, tested: int) -> tuple[int, float]:
        """
        Return the row of the most probable candidate, -1 for none, and its false alarm.

        Image stars base (K, 4) are taken for the stars star (K, 4). Those with least_support of
        other image stars or less are rejected.
        """
        return self._matcher.best_of_quads(image, sigma_rad, base, star, least_support, tested)


def _match(found: Verified) -> Match:
    false_alarm, focal_ratio, star, residual_px, attitude = found
    return Match(star, residual_px, attitude, focal_ratio, false_alarm)


def same_attitude(star: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two matches share two stars, which allow one attitude only."""
    return bool(np.count_nonzero((star >= 0) & (star == other)) >= 2)

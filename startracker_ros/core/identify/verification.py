# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Verification of a candidate attitude by all stars of the field.

A candidate assigns catalogue stars to a few image stars. The attitude and the focal length that
fit them associate the other image stars with the catalogue (association.py). The false-alarm
probability is that of so good an agreement by chance (false_alarm.py). A lens that differs from
its model is found by its near misses (lens_mismatch.py).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.camera.lens import plane_points, undistorted
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.catalog.sky_grid import count_in_image, count_near, SkyGrid
from startracker_ros.core.compiled import compiled
from startracker_ros.core.identify.association import align, fit
from startracker_ros.core.identify.false_alarm import (
    binomial_tail, CELLS, fisher_combined, occupied_cells, order_probability,
    residual_probability)
from startracker_ros.core.identify.lens_mismatch import lens_mismatch
from startracker_ros.core.identify.support import support, supporters
from startracker_ros.core.maths.sorting import upper_median

MAX_VERIFIED = 5
"""Candidates of one pattern that are verified, those with the most support."""

# Random directions at which the density of the sky is sampled.
_SAMPLES = 2000
_CORNERS = 33  # along each side of the image, of the cells whose solid angles are added


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


class Verification(NamedTuple):
    """
    The same in compiled code.

    residual (N,) is in undistorted coordinates (camera/lens.py); matrix (3, 3) turns sensor
    vectors to ICRF. A false_alarm of one means that the candidate is rejected.
    """

    false_alarm: float
    focal_ratio: float
    star: np.ndarray
    residual: np.ndarray
    matrix: np.ndarray


class VerifierData(NamedTuple):
    """
    Catalogue, camera and tolerances for the compiled functions.

    sky, hip (S,), magnitude (S,) and blended (S,) are the catalogue; equidistant is of the lens;
    field holds the borders of the image in undistorted coordinates (low, high, low, high) and the
    chord from its axis to the farthest corner; area is in rad^2; counts (F,) are the ascending
    numbers of stars in fields about random directions. Where bases_by_brightness, the stars of a
    candidate were chosen by their brightness, which is then no evidence for them. lens_known is
    False for a lens that is fitted after the identification: its near misses are then expected.
    """

    sky: SkyGrid
    hip: np.ndarray
    magnitude: np.ndarray
    blended: np.ndarray
    tolerance_sigmas: float
    scale_error: float
    equidistant: bool
    field: tuple[float, float, float, float, float]
    area: float
    counts: np.ndarray
    bases_by_brightness: bool
    lens_known: bool


class Verifier:
    """Verifies candidates against one catalogue and one camera."""

    def __init__(self, camera: Camera, onboard: OnboardCatalog, tolerance_sigmas: float,
                 scale_error: float, *, bases_by_brightness: bool = False,
                 lens_known: bool = True) -> None:
        self._pixel_rad = camera.pixel_rad
        area = camera.width * camera.height * camera.pixel_rad ** 2
        sky = onboard.grid
        self.data = VerifierData(
            sky, onboard.hip, onboard.magnitude, onboard.blended,
            float(tolerance_sigmas), float(scale_error), camera.model.equidistant,
            # A field of view wider than nominal contains stars from a little beyond.
            (*_borders(camera), 2 * np.sin(min(1.1 * camera.corner_angle_rad, np.pi) / 2)),
            area, _field_counts(sky, _solid_angle(camera)), bases_by_brightness, lens_known)

    def supported(self, image: np.ndarray, sigma_rad: np.ndarray, base: np.ndarray,
                  stars: np.ndarray) -> np.ndarray:
        """
        Return the candidates (K,) that further image stars support, the best first.

        image (N, 3) are the image stars, base (B,) those of the pattern, stars (M, B) the
        catalogue stars that they may be.
        """
        data = self.data
        stars_to_see = supporters(data.sky, image, sigma_rad, np.asarray(base),
                                  data.tolerance_sigmas)
        found = np.array([support(data.sky, stars_to_see, first, second, third, 0.0)
                          for first, second, third in stars[:, :3].tolist()])
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
        seen = plane_points(self.data.equidistant, image)
        return self.match(verify(
            self.data, seen, sigma_rad, np.asarray(base, int), np.asarray(star, int), tested),
            seen, sigma_rad)

    def match(self, result: Verification, seen: np.ndarray, sigma_rad: np.ndarray) -> Match:
        """Return a verification of all image stars with its attitude, seen (N, 2) in the plane."""
        attitude = None
        if result.false_alarm < 1:
            quaternion, covariance, residual_rad, chi2 = fit(
                self.data.sky, self.data.equidistant, seen, sigma_rad, result.focal_ratio,
                result.star, result.matrix)
            attitude = AttitudeEstimate(quaternion, covariance, len(residual_rad), residual_rad,
                                        chi2)
        return Match(result.star, result.residual / self._pixel_rad, attitude,
                     result.focal_ratio, result.false_alarm)


def _borders(camera: Camera) -> tuple[float, float, float, float]:
    """
    Return the least and largest undistorted coordinates a, then b, on the axes of the image.

    They are those of the image circle where that is smaller.
    """
    right, bottom = camera.width - 0.5, camera.height - 0.5
    middle_u, middle_v = (right - 0.5) / 2, (bottom - 0.5) / 2
    edges = undistorted(camera.lens, np.array([[-0.5, middle_v], [right, middle_v],
                                               [middle_u, -0.5], [middle_u, bottom]]))
    border = edges[[0, 1, 2, 3], [0, 0, 1, 1]]
    low_a, high_a, low_b, high_b = np.where(
        np.isnan(border), camera.lens.farthest_rad * np.array([-1, 1, -1, 1]), border).tolist()
    return low_a, high_a, low_b, high_b


def _solid_angle(camera: Camera) -> float:
    """Return that of the image in sr, or of its circle: a wide lens shows less than its area."""
    u, v = (np.linspace(-0.5, side - 0.5, _CORNERS) for side in (camera.width, camera.height))
    corner = camera.unproject(np.stack(np.meshgrid(u, v), axis=-1))
    across, down = np.diff(corner, axis=1)[:-1], np.diff(corner, axis=0)[:, :-1]
    return float(np.nansum(np.linalg.norm(np.cross(across, down), axis=-1)))


def _field_counts(sky: SkyGrid, solid_angle: float) -> np.ndarray:
    """Return the sorted numbers of stars in discs of a solid angle in sr."""
    # Archimedes: the cap of a sphere has the area of a disc whose radius is its chord.
    chord = min(np.sqrt(solid_angle / np.pi), 2.0)
    vectors = np.random.default_rng(0).standard_normal((_SAMPLES, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.sort(count_near(sky, vectors, chord))


@compiled
def same_attitude(star: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two matches share two stars, which leaves no room for two attitudes."""
    shared = 0
    for i in range(len(star)):
        shared += star[i] >= 0 and star[i] == other[i]
    return shared >= 2


@compiled
def rejected(count: int) -> Verification:
    """Return the verification of no candidate, for count image stars."""
    return Verification(1.0, 1.0, np.full(count, -1), np.full(count, np.nan), np.eye(3))


@compiled
def verify(verifier: VerifierData, seen: np.ndarray, sigma: np.ndarray, base: np.ndarray,
           star: np.ndarray, tested: int) -> Verification:
    """
    Verify that image stars base (B,) are the catalogue stars star (B,).

    seen (N, 2) are the image stars in undistorted coordinates, sigma (N,) their errors. The
    matching radius is r = tolerance_sigmas x median sigma; S, A, p, m, n and T as in
    false_alarm.py.
    """
    sky, equidistant, area = verifier.sky, verifier.equidistant, verifier.area
    r = verifier.tolerance_sigmas * upper_median(sigma)
    agrees, ratio, matched, residual, matrix = align(sky, equidistant, seen, sigma, base, star,
                                                     r, verifier.scale_error)
    if not agrees:
        return Verification(1.0, ratio, matched, residual, matrix)
    low_a, high_a, low_b, high_b, chord = verifier.field
    in_field = count_in_image(sky, equidistant, matrix, chord, low_a / ratio, high_a / ratio,
                              low_b / ratio, high_b / ratio, len(sky.direction))
    cells, brightest = occupied_cells(seen, matched, area, CELLS)
    # The stars of the base are no evidence for it.
    m = max(np.sum(brightest) - len(base), 0)
    n = max(cells - len(base), m)
    p = min(1.0, max(in_field, 1) * np.pi * r ** 2 / area)
    not_richer = max(int(np.searchsorted(verifier.counts, in_field, side='right')), 1)
    if verifier.bases_by_brightness:
        for i in base:
            brightest[i] = False
    product = (binomial_tail(m, n, p) * (not_richer / len(verifier.counts))
               * order_probability(matched, brightest)
               * residual_probability(residual, r, len(base)))
    false_alarm = min(1.0, max(tested, 1) * fisher_combined(product))
    if false_alarm < 1 and verifier.lens_known and lens_mismatch(
            sky, equidistant, verifier.blended, matrix, seen, ratio, r,
            r / verifier.tolerance_sigmas, matched, residual, m, p):
        false_alarm = 1.0
    return Verification(false_alarm, ratio, matched, residual, matrix)

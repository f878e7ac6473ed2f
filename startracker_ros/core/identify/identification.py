# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the identification methods share: options, usable stars, verification, result."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
import time

import numpy as np
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.deep import camera_catalog, DEEP_LIMIT
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.cache import cached_onboard
from startracker_ros.core.identify.star_matcher import usable_stars
from startracker_ros.core.identify.verification import Match, same_attitude, Verifier
from startracker_ros.core.options import option, Options
from startracker_ros.core.registry import METHODS

# The 170 brightest stars, which a field of more than 70 deg needs all: they are uneven in the sky.
_LEAST_LIMIT = 3.0


@dataclass(frozen=True)
class IdentificationOptions(Options):
    """How stars are identified, and when a result is accepted."""

    method: str = option('pyramid', 'how candidates are found', choices=tuple(METHODS))
    magnitude_limit: float = option(
        0.0, 'faintest stars of the pattern database, V; 0 chooses it so that a field holds '
        'twenty on average; beyond 9 only fields below 4 deg have stars', unit='mag', low=0.0,
        high=DEEP_LIMIT)
    max_image_stars: int = option(
        400, 'brightest centroids that are used', low=4, high=500)
    tolerance_sigmas: float = option(
        3.5, 'gate of the residuals, in standard deviations of the centroids', low=1.0,
        high=10.0)
    sigma_floor_px: float = option(
        0.2, 'standard deviation added to that of the centroids, for errors of the camera model',
        unit='px', low=0.0, high=10.0)
    fov_error_percent: float = option(
        0.5, 'tolerance of the focal length, which is fitted within', unit='%',
        low=0.0, high=5.0)
    false_alarm_max: float = option(
        1e-5, 'largest probability that an accepted result is chance', low=1e-30, high=0.1)
    time_limit_s: float = option(
        1.0, 'longest search in processor time, of pyramid that expected on a core of 3 GHz, so '
        'that other load changes no result',
        unit='s', low=0.001, high=600.0)


@dataclass(frozen=True)
class Identification:
    """
    Which catalogue star each of N centroids is.

    Attributes:
        status: 'identified', 'too_few_stars', 'no_candidate', 'ambiguous' or 'time_limit'.
        reason: The status in words.
        hip: (N,) int32, Hipparcos numbers, 0 where not identified.
        magnitude: (N,) float64, V, of the catalogue; NaN where not identified.
        residual_px: (N,) float64, px, from the catalogue position; NaN where not identified.
        attitude: Attitude of the sensor (AttitudeEstimate) with `quaternion` (4,), x, y, z, w,
            v_icrf = R(q) v_sensor, and `covariance_sensor` (3, 3) rad^2; None unless identified.
        focal_ratio: Fitted focal length over that of the camera.
        false_alarm_probability: Probability that the best candidate is chance.

    """

    status: str
    reason: str
    hip: np.ndarray
    magnitude: np.ndarray
    residual_px: np.ndarray
    attitude: AttitudeEstimate | None
    focal_ratio: float
    false_alarm_probability: float

    @property
    def matched(self) -> int:
        """Number of identified stars."""
        return int(np.count_nonzero(self.hip))


@dataclass(frozen=True)
class FieldStars:
    """
    The image stars that are used, brightest first.

    index (N,) are their rows among the centroids; direction (N, 3) unit vectors in the
    sensor frame; sigma_rad (N,) their errors per axis; flux (N,) in DN.
    """

    index: np.ndarray
    direction: np.ndarray
    sigma_rad: np.ndarray
    flux: np.ndarray

    def __len__(self) -> int:
        return len(self.index)


@dataclass(frozen=True)
class Candidates:
    """
    Catalogue stars that a few image stars may be.

    Args:
        base: (B,) int, rows of the field that `CandidateIdentifier.candidates()` received.
        stars: (M, B) int, rows of `CandidateIdentifier.onboard`, a candidate in each.

    """

    base: np.ndarray
    stars: np.ndarray

    def check(self, image_stars: int, catalogue_stars: int) -> None:
        """Raise ValueError for rows that the field or the catalogue does not have."""
        for name, rows, count, how in (
                ('base', self.base, image_stars, ''),
                ('stars', self.stars, catalogue_stars,
                 ': rows of self.onboard, whose index_of() finds those of HIP numbers')):
            if np.size(rows) and not 0 <= np.min(rows) <= np.max(rows) < count:
                raise ValueError(f'Candidates.{name} has rows from {np.min(rows)} to '
                                 f'{np.max(rows)}, there are {count}{how}')


class FrameByFrame:
    """Identifies one frame after the other, here each by its stars alone."""

    condition = ''
    """How the last frame was identified, in words."""

    def __init__(self, identifier: 'Identifier') -> None:
        self._identifier = identifier

    @property
    def has_rates(self) -> bool:
        """Whether rates of a gyro were received and are used."""
        return False

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Process a rate (3,) about sensor axes, measured up to a time; False if unusable."""
        return True

    def identify(self, stamp_ns: int, centroids: Centroids) -> Identification:
        """Return which stars the centroids of a frame are, later than the frame before."""
        return self._identifier.identify(centroids)


class Identifier(ABC):
    """
    Identifies frames of one camera at one epoch.

    A candidate is accepted only when all stars of the field verify it, whatever the method.
    Another thread may end a search: until_s (1,) is the time.monotonic() at which it ends.
    """

    stars_per_field = 20.0
    min_stars = 4
    bases_by_brightness = False
    lens_known = True
    uses_rates = False
    own_options: type[Options] | None = None

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 catalog: StarCatalog | None = None) -> None:
        """Build the pattern database, or load it from the cache."""
        catalog = self.catalog_for(camera) if catalog is None else catalog
        self.until_s = np.full(1, np.inf)
        self.camera = camera
        self.options = options
        self.magnitude_limit = options.magnitude_limit or limit_for(
            camera, catalog, self.stars_per_field)
        # Proper motion of a year is far below the tolerances: one database for the whole year.
        self.onboard = cached_onboard(catalog, camera, round(epoch_year), self.magnitude_limit)
        self._catalog_stars = len(self.onboard) * _share_of_sky(camera)

    @property
    def scale_error(self) -> float:
        """The error of the focal length, a share."""
        return self.options.fov_error_percent / 100

    @cached_property
    def verifier(self) -> Verifier:
        """Return what verifies candidates."""
        return Verifier(self.camera, self.onboard, self.options.tolerance_sigmas,
                        self.scale_error, bases_by_brightness=self.bases_by_brightness,
                        lens_known=self.lens_known)

    @abstractmethod
    def identify(self, centroids: Centroids) -> Identification:
        """Return which stars the centroids are; no content of an image raises an error."""

    @staticmethod
    def catalog_for(camera: Camera, band: BandOptions = BandOptions()) -> StarCatalog:
        """Return the catalogue of the package that the method uses, magnitudes in a band."""
        return camera_catalog(camera, band=band)

    def frame_by_frame(self, gyro: GyroErrorOptions) -> FrameByFrame:
        """Return what identifies frames in turn, by a gyro of these errors if it uses_rates."""
        return FrameByFrame(self)

    def field_stars(self, centroids: Centroids) -> FieldStars:
        """Return the brightest usable centroids, each star once."""
        index, direction, sigma_rad = usable_stars(
            self.camera, centroids, self.options.max_image_stars, self.options.sigma_floor_px)
        return FieldStars(index, direction, sigma_rad, centroids.flux[index])

    def identified(self, centroids: Centroids, field: FieldStars, match: Match) -> Identification:
        """Return an accepted match as the result."""
        hip, magnitude, residual_px = per_centroid(
            len(centroids), field.index, match.star, match.residual_px, self.onboard.hip,
            self.onboard.magnitude)
        return Identification('identified', f'{match.matched} stars', hip, magnitude, residual_px,
                              match.attitude, match.focal_ratio, match.false_alarm)

    def too_few(self, centroids: Centroids, count: int) -> Identification:
        """Return the result for a field of count usable stars, too few for a pattern."""
        return self.unidentified(centroids, 'too_few_stars',
                                 f'{count} usable stars, {self.options.method} needs '
                                 f'{self.min_stars}: expose longer or lower the threshold')

    def unidentified(self, centroids: Centroids, status: str, reason: str,
                     false_alarm: float = 1.0) -> Identification:
        """Return the result without an attitude; false_alarm is that of the best candidate."""
        count = len(centroids)
        return Identification(status, reason, np.zeros(count, np.int32), np.full(count, np.nan),
                              np.full(count, np.nan), None, 1.0, false_alarm)

    def time_limit(self, centroids: Centroids, tested: int,
                   false_alarm: float) -> Identification:
        """Return the result of a search that reached time_limit_s, or was ended before."""
        why = ('not identified before a newer frame came'
               if time.monotonic() > self.until_s[0] else
               f'not identified within time_limit_s = {self.options.time_limit_s:g}')
        return self.unidentified(
            centroids, 'time_limit', f'{why}, {tested} candidates tested', false_alarm)

    def no_candidate(self, centroids: Centroids, count: int, tested: int,
                     false_alarm: float) -> Identification:
        """Return the result of a search of count stars in which no candidate was accepted."""
        return self.unidentified(
            centroids, 'no_candidate', f'{count} stars, {tested} candidates tested, none is '
            'verified: many false stars, a wrong focal length, or a magnitude limit that '
            f'does not fit (a field holds {self._catalog_stars:.1f} catalogue stars on average)',
            false_alarm)


class CandidateIdentifier(Identifier):
    """
    Base of a custom identification method: a subclass yields candidates, the field verifies them.

    `self.onboard` has the unit vectors `direction` (M, 3) of the catalogue stars on ICRF axes,
    `self.camera` is the lens, `self.options` those of star_identifier. Pass the class as the
    `method` of `identify()`.
    """

    @abstractmethod
    def candidates(self, field: FieldStars) -> Iterator[Candidates]:
        """
        Yield what a few image stars may be, the most probable candidates first.

        Args:
            field: Usable stars of the image, brightest first: `direction` (N, 3) unit vectors in
                the sensor frame, `sigma_rad` (N,) errors per axis, `flux` (N,) DN.

        Returns:
            Iterator of `Candidates`; the search ends with the first one that is verified.

        """

    def identify(self, centroids: Centroids) -> Identification:
        """Return the first candidate that is verified; ValueError for one of no such stars."""
        field = self.field_stars(centroids)
        if len(field) < self.min_stars:
            return self.too_few(centroids, len(field))
        deadline_s = time.thread_time() + self.options.time_limit_s
        false_alarm = 1.0
        tested = 0
        for found in self.candidates(field):
            found.check(len(field), len(self.onboard))
            tested += len(found.stars)
            supported = self.verifier.supported(field.direction, field.sigma_rad, found.base,
                                                found.stars)
            matches = [self.verifier.verify(field.direction, field.sigma_rad, found.base,
                                            found.stars[candidate], tested)
                       for candidate in supported]
            matches.sort(key=lambda match: match.false_alarm)
            if matches:
                false_alarm = min(false_alarm, matches[0].false_alarm)
                if false_alarm <= self.options.false_alarm_max:
                    return self._decide(centroids, field, matches)
            if time.thread_time() > deadline_s or time.monotonic() > self.until_s[0]:
                return self.time_limit(centroids, tested, false_alarm)
        return self.no_candidate(centroids, len(field), tested, false_alarm)

    def _decide(self, centroids: Centroids, field: FieldStars,
                matches: list[Match]) -> Identification:
        """Return the best of the verified candidates, unless another one contradicts it."""
        best = matches[0]
        for other in matches[1:]:
            if (other.false_alarm <= self.options.false_alarm_max
                    and not same_attitude(other.star, best.star)):
                return self.unidentified(
                    centroids, 'ambiguous', 'two attitudes fit the field '
                    f'({best.matched} and {other.matched} stars)', best.false_alarm)
        return self.identified(centroids, field, best)


def per_centroid(count: int, index: np.ndarray, star: np.ndarray, residual_px: np.ndarray,
                 hip: np.ndarray, magnitude: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return hip, magnitude and residual of all count centroids: 0 or NaN where unmatched.

    index (N,) are the rows of the image stars, star (N,) their catalogue indices, -1 for none.
    """
    hips = np.zeros(count, np.int32)
    magnitudes, residuals_px = np.full((2, count), np.nan)
    known = star >= 0
    rows = index[known]
    hips[rows], magnitudes[rows] = hip[star[known]], magnitude[star[known]]
    residuals_px[rows] = residual_px[known]
    return hips, magnitudes, residuals_px


def _share_of_sky(camera: Camera) -> float:
    return camera.fov_x_rad * camera.fov_y_rad / (4 * np.pi)


def limit_for(camera: Camera, catalog: StarCatalog, stars_per_field: float) -> float:
    """Return the magnitude limit at which a field holds stars_per_field stars on average."""
    wanted = min(int(stars_per_field / _share_of_sky(camera)), len(catalog) - 1)
    # Rounded up, so that cameras that are nearly alike share a database.
    return float(max(np.ceil(catalog.magnitude[wanted] * 10) / 10, _LEAST_LIMIT))

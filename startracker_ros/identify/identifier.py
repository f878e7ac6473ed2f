"""Lost-in-space identification of one frame: which star is which, or why nobody can say."""

from dataclasses import dataclass
import time

import numpy as np

from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.camera import Camera
from startracker_ros.catalog.places import camera_places
from startracker_ros.catalog.stars import load_catalog, StarCatalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.identify.cache import cached_pairs
from startracker_ros.identify.pyramid import matching_triangles, triads
from startracker_ros.identify.verification import Match, Verifier
from startracker_ros.options import option, Options
from startracker_ros.rotation import attitude_error

_MIN_STARS = 4
# Two centroids closer than this are one star that was found twice.
_DUPLICATE_PX = 1.5
# Sides of a triangle shorter than this say little beside their noise.
_MIN_SEPARATION_PX = 20.0
_STARS_PER_FIELD = 20.0


@dataclass(frozen=True)
class IdentificationOptions(Options):
    """How stars are identified, and when an answer is believed."""

    magnitude_limit: float = option(
        0.0, 'faintest stars of the pattern database, V; 0 chooses it so that a field holds '
        'twenty on average', unit='mag', low=0.0, high=9.0)
    max_image_stars: int = option(
        20, 'brightest centroids that are looked at', low=4, high=200)
    tolerance_sigmas: float = option(
        3.5, 'how far stars may stand from where they should, in errors of their centroids',
        low=1.0, high=10.0)
    sigma_floor_px: float = option(
        0.2, 'error added to that of the centroids, for what the camera model leaves over',
        unit='px', low=0.0, high=10.0)
    fov_error_percent: float = option(
        0.5, 'how far the focal length may be off; it is fitted within', unit='%',
        low=0.0, high=5.0)
    false_alarm_max: float = option(
        1e-5, 'largest probability that a believed answer is chance', low=1e-30, high=0.1)
    time_limit_s: float = option(
        1.0, 'longest search', unit='s', low=0.001, high=600.0)


@dataclass(frozen=True)
class Identification:
    """Which catalogue star each centroid is.

    status is identified, too_few_stars, no_candidate, ambiguous or time_limit; reason says
    more. hip (N,) int32 is 0 where not identified, magnitude and residual_px (N,) NaN
    there. attitude is None unless identified. focal_ratio is the fitted focal length over
    that of the camera; false_alarm_probability that of the best candidate.
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


class StarIdentifier:
    """Identifies frames of one camera at one epoch; keeps no state between frames."""

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 catalog: StarCatalog | None = None) -> None:
        """Build the pattern database, or take it from the cache."""
        catalog = load_catalog() if catalog is None else catalog
        self.camera = camera
        self.options = options
        self.magnitude_limit = options.magnitude_limit or _limit_for(camera, catalog)
        # A year of proper motion is nothing to the tolerances, and one database serves it all.
        self._places = camera_places(catalog, camera, round(epoch_year), self.magnitude_limit)
        self._pairs = cached_pairs(self._places, _MIN_SEPARATION_PX * camera.pixel_rad,
                                   2 * camera.corner_angle_rad * (1 + self._scale_error))
        self._directions = self._places.direction[self._pairs.star]
        self._verifier = Verifier(camera, self._places, options.tolerance_sigmas,
                                  self._scale_error)

    @property
    def _scale_error(self) -> float:
        return self.options.fov_error_percent / 100

    def identify(self, centroids: Centroids) -> Identification:
        """Return which stars the centroids are; never raises for what an image may hold."""
        used = self._usable(centroids)
        if len(used) < _MIN_STARS:
            return self._nothing(centroids, 'too_few_stars',
                                 f'{len(used)} usable stars, identification takes '
                                 f'{_MIN_STARS}: expose longer or lower the threshold')
        image = self.camera.unproject(centroids.uv[used])
        sigma_rad = self.camera.pixel_rad * np.hypot(
            centroids.sigma_px[used], self.options.sigma_floor_px)
        deadline_s = time.perf_counter() + self.options.time_limit_s
        best: Match | None = None
        tested = 0
        for index in triads(self._pairs, image, sigma_rad, self.options.tolerance_sigmas,
                            self._scale_error):
            triangles = matching_triangles(
                self._pairs, self._directions, image[index], sigma_rad[index],
                self.options.tolerance_sigmas, self._scale_error)
            tested += len(triangles)
            stars = self._pairs.star[triangles]
            supported = self._verifier.supported(image, sigma_rad, index, stars)
            matches = [self._verifier.judge(image, sigma_rad, index, stars[candidate], tested)
                       for candidate in supported]
            matches.sort(key=lambda match: match.chance)
            if matches and (best is None or matches[0].chance < best.chance):
                best = matches[0]
            if matches and matches[0].chance <= self.options.false_alarm_max:
                return self._decide(centroids, used, matches)
            if time.perf_counter() > deadline_s:
                return self._nothing(
                    centroids, 'time_limit', f'no answer within time_limit_s = '
                    f'{self.options.time_limit_s:g}, {tested} candidates tested', best)
        return self._nothing(
            centroids, 'no_candidate', f'{len(used)} stars, {tested} candidates tested, none is '
            'surely right: too few catalogue stars, many false ones, or a wrong focal length',
            best)

    def _usable(self, centroids: Centroids) -> np.ndarray:
        """Return indices of the brightest sound centroids, each star once."""
        sound = (np.isfinite(centroids.uv).all(1) & np.isfinite(centroids.sigma_px)
                 & (centroids.sigma_px > 0) & self.camera.contains(centroids.uv))
        index = np.flatnonzero(sound)
        index = index[np.argsort(-centroids.flux[index], kind='stable')]
        index = index[:4 * self.options.max_image_stars]
        uv = centroids.uv[index]
        close = np.linalg.norm(uv[:, None] - uv[None], axis=2) < _DUPLICATE_PX
        repeated = np.tril(close, -1).any(1)
        return index[~repeated][:self.options.max_image_stars]

    def _decide(self, centroids: Centroids, used: np.ndarray,
                matches: list[Match]) -> Identification:
        """Return the best of the verified candidates, unless another one contradicts it."""
        best = matches[0]
        for other in matches[1:]:
            if other.chance > self.options.false_alarm_max:
                break
            apart = attitude_error(other.attitude.quaternion, best.attitude.quaternion)
            if np.linalg.norm(apart) > 20 * self.camera.pixel_rad:
                return self._nothing(centroids, 'ambiguous', 'two attitudes fit the field '
                                     f'({best.matched} and {other.matched} stars)', best)
        count = len(centroids)
        hip = np.zeros(count, np.int32)
        magnitude, residual_px = np.full(count, np.nan), np.full(count, np.nan)
        known = best.star >= 0
        hip[used[known]] = self._places.hip[best.star[known]]
        magnitude[used[known]] = self._places.magnitude[best.star[known]]
        residual_px[used[known]] = best.residual_px[known]
        return Identification('identified', f'{best.matched} stars', hip, magnitude, residual_px,
                              best.attitude, best.focal_ratio, best.chance)

    @staticmethod
    def _nothing(centroids: Centroids, status: str, reason: str,
                 best: Match | None = None) -> Identification:
        count = len(centroids)
        return Identification(status, reason, np.zeros(count, np.int32), np.full(count, np.nan),
                              np.full(count, np.nan), None, 1.0,
                              1.0 if best is None else best.chance)


def _limit_for(camera: Camera, catalog: StarCatalog) -> float:
    """Return the magnitude to which a field holds _STARS_PER_FIELD stars on average."""
    share = camera.fov_x_rad * camera.fov_y_rad / (4 * np.pi)
    wanted = min(int(_STARS_PER_FIELD / share), len(catalog) - 1)
    # Rounded up, so that cameras that are nearly alike share a database.
    return float(np.ceil(catalog.magnitude[wanted] * 10) / 10)

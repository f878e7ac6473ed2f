# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Grid patterns over an image that a gyro and the catalogue extend beyond its edges.

Qian, Sun, Cai, Huang, for narrow fields: the attitude that the gyro predicts gives the
catalogue stars of an extended field, image A. The observed stars replace the part of A
within the true field, which makes the combined image C. A star is recognised by the grid
algorithm (Padgett and Kreutz-Delgado 1997) over C.

Unlike in the paper a pattern alone is not accepted, because that of two or three stars is weak
evidence. A recognised star must agree with its predicted direction, and together
with it the other stars must agree with theirs (prior_verification.py).
"""

from dataclasses import dataclass
from threading import Lock

import numpy as np
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.estimate import AttitudeError, estimate_attitude
from startracker_ros.core.attitude.gyro import Gyro, GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions, catalog_in_band
from startracker_ros.core.catalog.stars import load_catalog, StarCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import (
    FieldStars, FrameByFrame, Identification, IdentificationOptions)
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.identify.verification import Match
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, matrix_from_quaternion
from startracker_ros.core.options import option, Options
from startracker_ros.core.papers.prior_verification import partial_derivatives, PriorVerifier

_MIN_STARS = 2
# Share of its cells that a pattern must have in common. At 0.35 px and 0.2 mag 99 % of the right
# ones have 0.6 or more, 99 % of the wrong ones 0.23 or less.
_MIN_SHARED = 1 / 3
# The catalogue stars are taken up to these magnitudes about the limit of the image. Of stars next
# to it some are in one of both only, and the nearest of them gives a grid its direction. Rows
# "grid, one limit" of campaign extended-grid show what one limit loses at 0.2 mag of noise; five
# limits gain nothing more.
_LIMITS_MAG = (-0.2, 0.0, 0.2)
# Limit of the tangent plane of a very wide extended field.
_MAX_HALF_FIELD_RAD = np.radians(75.0)


@dataclass(frozen=True)
class ExtendedGridOptions(Options):
    """The grid of the paper; method extended_grid only."""

    extended_field: float = option(
        2.0, 'width of the extended field in widths of the image', low=1.0, high=10.0)
    grid_cell_deg: float = option(
        0.2, 'width of a cell of the grid', unit='deg', low=0.001, high=10.0)
    grid_cells: int = option(40, 'cells along each side of the grid', low=4, high=1000)
    grid_buffer_deg: float = option(
        0.3, 'nearer neighbours than this do not define the direction of the grid', unit='deg',
        low=0.0, high=10.0)


# --- the attitude between two frames, propagated by gyro rates ---


@dataclass(frozen=True)
class AttitudePrediction:
    """
    A propagated attitude.

    quaternion (4,) is q_icrf_from_sensor; covariance_sensor (3, 3) rad^2 that of
    rotation.attitude_error, a rotation vector about sensor axes.
    """

    quaternion: np.ndarray
    covariance_sensor: np.ndarray


class AttitudePropagator:
    """
    Attitude and gyro drift, propagated by gyro rates and updated by attitudes of frames.

    A prediction beyond the newest rate does not harm the next one: rates that come late, as
    those of a stopped process do, are used then.
    """

    def __init__(self, options: GyroErrorOptions = GyroErrorOptions()) -> None:
        self._gyro = Gyro(options)
        # That of the newest rate, and that of the last prediction.
        self._state: AttitudeState | None = None
        self._predicted: AttitudeState | None = None

    @property
    def has_rates(self) -> bool:
        """Whether any rate was measured so far."""
        return len(self._gyro) > 0

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Add a rate as Gyro.add does."""
        return self._gyro.add(stamp_ns, rate_rad_s)

    def start(self, stamp_ns: int, quaternion: np.ndarray,
              covariance_sensor: np.ndarray) -> None:
        """Begin with an attitude and an unknown drift."""
        covariance = np.zeros((9, 9))
        covariance[:3, :3] = covariance_sensor
        self._state = AttitudeState(
            stamp_ns, quaternion, np.zeros(3), np.zeros(3), covariance).with_new_drift(
            self._gyro.drift_sigma_rad_s)

    def predict(self, stamp_ns: int) -> AttitudePrediction | None:
        """Return the attitude at a time, None before the first one or without any rate."""
        if self._state is None or stamp_ns < self._state.stamp_ns or not self.has_rates:
            return None
        self._state, self._predicted = self._gyro.predict(self._state, stamp_ns)
        return AttitudePrediction(self._predicted.quaternion, self._predicted.covariance[:3, :3])

    def correct(self, quaternion: np.ndarray, covariance_sensor: np.ndarray) -> None:
        """Update by the attitude of a frame at the time of the last prediction, if any."""
        if self._predicted is None:
            return
        information = np.linalg.inv(covariance_sensor)
        innovation = attitude_error(quaternion, self._predicted.quaternion)
        self._state = self._predicted.with_attitude(information, information @ innovation)


# --- grids over a predicted field ---


@dataclass(frozen=True)
class PredictedField:
    """
    The catalogue stars of the extended field at the predicted attitude, brightest first.

    star (M,) are catalogue indices; tangent (M, 2) is x / z, y / z in the sensor frame;
    magnitude (M,) ascends; inside (M,) bool is True within the image, near (M,) also where the
    error of the prediction may have moved a star of the image.
    """

    star: np.ndarray
    tangent: np.ndarray
    magnitude: np.ndarray
    inside: np.ndarray
    near: np.ndarray

    def select(self, chosen: np.ndarray | slice) -> 'PredictedField':
        """Return the stars of a mask (M,), of indices or of a slice."""
        return PredictedField(self.star[chosen], self.tangent[chosen], self.magnitude[chosen],
                              self.inside[chosen], self.near[chosen])

    def brightest(self, observed: int) -> 'PredictedField':
        """
        Return the brightest stars, so many that as many of them are inside as were observed.

        The limiting magnitude of the sensor is then no parameter, and may change with exposure.
        """
        beyond = np.flatnonzero(self.inside)[observed:]
        count = beyond[0] if len(beyond) else len(self.star)
        return self.select(slice(count))

    def about_limit(self, observed: int) -> list['PredictedField']:
        """Return the brightest stars to limits about that of an image of observed stars."""
        limit = self.brightest(observed).magnitude.max(initial=-np.inf)
        return [self.select(slice(np.searchsorted(self.magnitude, limit + offset, 'right')))
                for offset in _LIMITS_MAG]


class ExtendedGridIdentifier(PyramidIdentifier):
    """The Pyramid while lost in space; with a predicted attitude two stars suffice."""

    uses_rates = True
    own_options = ExtendedGridOptions

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 catalog: StarCatalog | None = None,
                 grid: ExtendedGridOptions = ExtendedGridOptions()) -> None:
        """Build the pattern database of the Pyramid; the grid needs none."""
        super().__init__(camera, epoch_year, options, catalog)
        self._cell = np.radians(grid.grid_cell_deg)
        self._cells = grid.grid_cells
        self.buffer_rad = np.radians(grid.grid_buffer_deg)
        self._half_field = np.tan(np.minimum(
            grid.extended_field / 2 * np.array([camera.fov_x_rad, camera.fov_y_rad]),
            _MAX_HALF_FIELD_RAD))
        self._area = camera.width * camera.height * camera.pixel_rad ** 2

    @staticmethod
    def catalog_for(camera: Camera, band: BandOptions = BandOptions()) -> StarCatalog:
        # Two stars are identified by the bright stars alone, as published: no deep catalogue.
        return catalog_in_band(load_catalog(), band)

    def frame_by_frame(self, gyro: GyroErrorOptions) -> 'RecursiveIdentifier':
        return RecursiveIdentifier(self, gyro)

    def captures(self, prior: AttitudePrediction) -> bool:
        """Return whether a prediction is accurate enough to put stars into their cells."""
        corners = self._half_field * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
        partial = partial_derivatives(corners)[:, :, :3]
        covariance = partial @ prior.covariance_sensor @ partial.transpose(0, 2, 1)
        sigma = np.sqrt(np.linalg.eigvalsh(covariance).max())
        return bool(self.options.tolerance_sigmas * sigma <= self._cell)

    def identify(self, centroids: Centroids,
                 prior: AttitudePrediction | None = None) -> Identification:
        """Return which stars the centroids are, with a predicted attitude if there is one."""
        if prior is None or not self.captures(prior):
            return super().identify(centroids)
        field = self.field_stars(centroids)
        if len(field) < _MIN_STARS:
            return self.unidentified(
                centroids, 'too_few_stars',
                f'{len(field)} usable stars, with a predicted attitude {_MIN_STARS} are needed')
        observed = field.direction[:, :2] / field.direction[:, 2:]
        predicted = self.predicted_field(prior.quaternion)
        recognised = self.recognise(observed, predicted)
        # Rows of all predicted stars become rows of those near the image.
        known = recognised >= 0
        recognised[known] = np.cumsum(predicted.near)[recognised[known]] - 1
        return self._verify_with_prior(centroids, field, observed,
                                       predicted.select(predicted.near), recognised, prior)

    def predicted_field(self, quaternion: np.ndarray) -> PredictedField:
        """Return the catalogue stars of the extended field, image A."""
        matrix = matrix_from_quaternion(quaternion)
        near = self.onboard.within(matrix[:, 2], np.arctan(np.hypot(*self._half_field)))
        direction = self.onboard.direction[near] @ matrix
        tangent = direction[:, :2] / direction[:, 2:]
        within = (np.abs(tangent) <= self._half_field).all(1)
        uv = self.camera.project(direction[within])
        return PredictedField(near[within], tangent[within], self.onboard.magnitude[near[within]],
                              self.camera.contains(uv),
                              self.camera.contains(uv, -self._cell / self.camera.pixel_rad))

    def recognise(self, observed: np.ndarray, predicted: PredictedField) -> np.ndarray:
        """Return for each observed star (N, 2) the row of the predicted star, -1 for none."""
        image = predicted.brightest(len(observed))
        return self.match(observed, image.tangent[~image.inside],
                          predicted.about_limit(len(observed)))

    def match(self, observed: np.ndarray, beyond: np.ndarray, images: list[PredictedField]
              ) -> np.ndarray:
        """
        Return for each observed star (N, 2) the row of the predicted star, -1 for none.

        The combined image C is that of the observed stars and of those beyond the edge (K, 2).
        images are A to one or several limits. The star is the one whose pattern over one of
        these has most cells in common with that of the observed star over C, provided that
        these are enough and that no other observed star has more in common with it.
        """
        deepest = max(images, key=lambda image: len(image.star))
        known = np.flatnonzero(deepest.inside)
        if not len(known) or not len(observed):
            return np.full(len(observed), -1)
        pattern, _ = self.patterns(np.concatenate([observed, beyond]), np.arange(len(observed)))
        common = np.zeros((len(observed), len(known)))
        for image in images:
            # The images are of the same stars in the same order, up to their limit.
            reference = known[:np.searchsorted(known, len(image.star))]
            if len(reference):
                catalogue, _ = self.patterns(image.tangent, reference)
                shared = common[:, :len(reference)]
                np.maximum(shared, pattern @ catalogue.T, out=shared)
        best = common.argmax(1)
        star = np.arange(len(observed))
        enough = common[star, best] >= _MIN_SHARED * pattern.sum(1)
        return np.where(enough & (common.argmax(0)[best] == star), known[best], -1)

    def patterns(self, tangent: np.ndarray, reference: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the occupied cells (K, g * g) around reference stars (K,) among stars (N, 2).

        1 for an occupied cell and 0 for an empty one, float32; and the neighbour (K,) that
        defines the direction of each grid.
        """
        offset = tangent - tangent[reference][:, None]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        distance = np.where(distance > self.buffer_rad, distance, np.inf)
        neighbour = distance.argmin(1)
        row = np.arange(len(reference))
        axis = offset[row, neighbour]
        length = np.hypot(axis[:, 0], axis[:, 1])
        # A star without a neighbour has a grid along the axes of the image.
        alone = length <= self.buffer_rad
        axis = np.where(alone[:, None], [1.0, 0.0], axis / np.where(alone, 1, length)[:, None])
        along = offset[..., 0] * axis[:, :1] + offset[..., 1] * axis[:, 1:]
        across = offset[..., 1] * axis[:, :1] - offset[..., 0] * axis[:, 1:]
        # The reference star is in the middle of a cell, so that its neighbour on the x axis is
        # not on the border of two.
        centre = self._cells // 2 + 0.5
        x = np.floor(along / self._cell + centre).astype(int)
        y = np.floor(across / self._cell + centre).astype(int)
        k, n = np.nonzero((x >= 0) & (x < self._cells) & (y >= 0) & (y < self._cells))
        cells = np.zeros((len(reference), self._cells ** 2), np.float32)
        cells[k, y[k, n] * self._cells + x[k, n]] = 1
        return cells, neighbour

    def _verify_with_prior(self, centroids: Centroids, field: FieldStars, observed: np.ndarray,
                           predicted: PredictedField, recognised: np.ndarray,
                           prior: AttitudePrediction) -> Identification:
        """Return the result that the recognised stars and the prediction agree on."""
        options = self.options
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = prior.covariance_sensor
        covariance[3, 3] = (self.scale_error / options.tolerance_sigmas) ** 2
        verifier = PriorVerifier(observed, field.sigma_rad, predicted.tangent, predicted.inside,
                                 covariance, options.tolerance_sigmas, self._area)
        found = verifier.verify(recognised, self.onboard.crowded[predicted.star],
                                options.false_alarm_max)
        count = f'{np.count_nonzero(recognised >= 0)} of {len(field)} stars recognised'
        if found is None:
            return self.unidentified(centroids, 'no_candidate',
                                     f'{count}, none agrees with the predicted attitude')
        known = found.row >= 0
        star = np.where(known, predicted.star[found.row], -1)
        if found.contradicted:
            return self.unidentified(centroids, 'ambiguous', f'{count}, they fit two attitudes',
                                     found.false_alarm)
        if found.false_alarm > options.false_alarm_max:
            return self.unidentified(
                centroids, 'no_candidate', f'{count}, {np.count_nonzero(known)} agree with the '
                'predicted attitude: that may be chance', found.false_alarm)
        tangent = observed[known] / found.focal_ratio
        try:
            attitude = estimate_attitude(
                np.column_stack([tangent, np.ones(len(tangent))]),
                self.onboard.direction[star[known]], field.sigma_rad[known])
        except AttitudeError as error:
            return self.unidentified(centroids, 'no_candidate', str(error), found.false_alarm)
        residual_px = np.full(len(field), np.nan)
        residual_px[known] = attitude.residual_rad / self.camera.pixel_rad
        return self.identified(centroids, field, Match(
            star, residual_px, attitude, found.focal_ratio, found.false_alarm))


# --- from frame to frame ---


class RecursiveIdentifier(FrameByFrame):
    """Extended-grid identification from frame to frame, propagated by the gyro in between."""

    def __init__(self, identifier: ExtendedGridIdentifier,
                 gyro: GyroErrorOptions = GyroErrorOptions()) -> None:
        self._identifier: ExtendedGridIdentifier = identifier
        self._propagator = AttitudePropagator(gyro)
        # Rates may come in another thread than frames, which it never stops for a search.
        self._propagates = Lock()
        self.condition = 'no frame yet'

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        with self._propagates:
            return self._propagator.add_rate(stamp_ns, rate_rad_s)

    @property
    def has_rates(self) -> bool:
        return self._propagator.has_rates

    def identify(self, stamp_ns: int, centroids: Centroids) -> Identification:
        """
        Return which stars the centroids of a frame are, later than the frame before.

        A frame that is not identified does not correct the prediction. Its covariance grows
        until the grid cannot use it any more: then frames are identified lost in space, unless
        the rates that were missing come later.
        """
        with self._propagates:
            prior = self._propagator.predict(stamp_ns)
        if prior is not None and not self._identifier.captures(prior):
            prior = None
        result = self._identifier.identify(centroids, prior)
        if prior is not None and result.attitude is None:
            # A prediction that is off by more than its covariance must not hide a field that
            # needs none.
            lost = self._identifier.identify(centroids)
            if lost.attitude is not None:
                result, prior = lost, None
        self.condition = self._condition(prior)
        if result.attitude is not None:
            attitude = result.attitude.quaternion, result.attitude.covariance_sensor
            with self._propagates:
                if prior is None:
                    self._propagator.start(stamp_ns, *attitude)
                else:
                    self._propagator.correct(*attitude)
        return result

    def _condition(self, prior: AttitudePrediction | None) -> str:
        if prior is None:
            return f'no {"prediction" if self.has_rates else "imu"}, lost in space'
        sigma = np.sqrt(np.diag(prior.covariance_sensor).max()) / ARCSEC
        return f'predicted by the gyro within {sigma:.1f} arcsec, 1 sigma'

"""
Grid patterns over an image that the gyro and the catalogue extend beyond its edges.

Qian, Sun, Cai, Huang, for narrow fields: the attitude that the gyro predicts gives the
catalogue stars of an extended field, image A. The observed stars replace the part of A
within the true field, which makes the combined image C. A star is recognised by the grid
algorithm (Padgett and Kreutz-Delgado 1997) over C.

Beyond the paper nothing is believed for its pattern alone, because two or three stars
leave a pattern little to say. A recognised star has to stand where the gyro predicts it,
and together with it the other stars too.
"""

from dataclasses import dataclass

import numpy as np
from startracker_ros.attitude.estimate import AttitudeError, estimate_attitude
from startracker_ros.attitude.gyro import GyroErrorOptions
from startracker_ros.attitude.propagate import AttitudePrediction, AttitudePropagator
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.stars import StarCatalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.identify.identification import (
    FieldStars, Identification, IdentificationOptions)
from startracker_ros.identify.prior_verification import partial_derivatives, PriorVerifier
from startracker_ros.identify.pyramid import PyramidIdentifier
from startracker_ros.identify.verification import Match
from startracker_ros.maths.rotation import ARCSEC, matrix_from_quaternion
from startracker_ros.options import option, Options

_MIN_STARS = 2
# Cells that a pattern has to share. At 0.35 px and 0.2 mag 99 % of the right answers share
# 0.6 of theirs or more, 99 % of the wrong ones 0.23 or less.
_MIN_SHARED = 1 / 3
# The tangent plane of a very wide extended field is cut here.
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
        0.3, 'nearer neighbours than this do not give the direction of the grid', unit='deg',
        low=0.0, high=10.0)


@dataclass(frozen=True)
class PredictedField:
    """
    The catalogue stars of the extended field at the predicted attitude, brightest first.

    star (M,) are indices into the places; place (M, 2) is x / z, y / z in the sensor frame;
    inside (M,) bool is True within the image, near (M,) also where a prediction that is off may
    have put a star of the image.
    """

    star: np.ndarray
    place: np.ndarray
    inside: np.ndarray
    near: np.ndarray

    def select(self, chosen: np.ndarray | slice) -> 'PredictedField':
        """Return the stars of a mask (M,), of indices or of a slice."""
        return PredictedField(self.star[chosen], self.place[chosen], self.inside[chosen],
                              self.near[chosen])

    def brightest(self, observed: int) -> 'PredictedField':
        """
        Return the stars down to where as many of them are inside as were observed.

        How faint a sensor sees is then no parameter, and changes with the exposure as it may.
        """
        beyond = np.flatnonzero(self.inside)[observed:]
        count = beyond[0] if len(beyond) else len(self.star)
        return self.select(slice(count))


class ExtendedGridIdentifier(PyramidIdentifier):
    """The Pyramid while lost in space; with a predicted attitude two stars are enough."""

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

    def captures(self, prior: AttitudePrediction) -> bool:
        """Return whether a prediction is sure enough to put stars into their cells."""
        corners = self._half_field * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
        partial = partial_derivatives(corners)[:, :, :3]
        spread = partial @ prior.covariance_sensor @ partial.transpose(0, 2, 1)
        sigma = np.sqrt(np.linalg.eigvalsh(spread).max())
        return bool(self.options.tolerance_sigmas * sigma <= self._cell)

    def identify(self, centroids: Centroids,
                 prior: AttitudePrediction | None = None) -> Identification:
        """Return which stars the centroids are, given a predicted attitude if there is one."""
        if prior is None or not self.captures(prior):
            return super().identify(centroids)
        field = self.field_stars(centroids)
        if len(field) < _MIN_STARS:
            return self.nothing(centroids, 'too_few_stars',
                                f'{len(field)} usable stars, the prediction takes {_MIN_STARS}')
        observed = field.direction[:, :2] / field.direction[:, 2:]
        predicted = self.predicted_field(prior.quaternion)
        votes = self.recognise(observed, predicted)
        # Rows of all stars become rows of those near the image, where the answer is.
        known = votes >= 0
        votes[known] = np.cumsum(predicted.near)[votes[known]] - 1
        return self._decide_with_prior(centroids, field, observed,
                                       predicted.select(predicted.near), votes, prior)

    def predicted_field(self, quaternion: np.ndarray) -> PredictedField:
        """Return the catalogue stars of the extended field, image A."""
        matrix = matrix_from_quaternion(quaternion)
        near = self.places.within(matrix[:, 2], np.arctan(np.hypot(*self._half_field)))
        direction = self.places.direction[near] @ matrix
        place = direction[:, :2] / direction[:, 2:]
        kept = (np.abs(place) <= self._half_field).all(1)
        uv = self.camera.project(direction[kept])
        return PredictedField(near[kept], place[kept], self.camera.contains(uv),
                              self.camera.contains(uv, -self._cell / self.camera.pixel_rad))

    def recognise(self, observed: np.ndarray, predicted: PredictedField) -> np.ndarray:
        """
        Return for each observed place (N, 2) the row of the predicted star, -1 for none.

        Each takes the star whose pattern over A has most cells in common with its own
        over C, provided that these are enough and that no other observed star has more in
        common with that one.
        """
        image = predicted.brightest(len(observed))
        known = np.flatnonzero(image.inside)
        if not len(known):
            return np.full(len(observed), -1)
        combined = np.concatenate([observed, image.place[~image.inside]])
        pattern, _ = self.patterns(combined, np.arange(len(observed)))
        catalogue, _ = self.patterns(image.place, known)
        equal = pattern @ catalogue.T
        best = equal.argmax(1)
        star = np.arange(len(observed))
        enough = equal[star, best] >= _MIN_SHARED * pattern.sum(1)
        return np.where(enough & (equal.argmax(0)[best] == star), known[best], -1)

    def patterns(self, place: np.ndarray, reference: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the occupied cells (K, g * g) around reference stars (K,) among places (N, 2).

        1 for an occupied cell and 0 for an empty one, float32; and the neighbour (K,) that
        gave the direction of each grid.
        """
        away = place - place[reference][:, None]
        distance = np.hypot(away[..., 0], away[..., 1])
        distance = np.where(distance > self.buffer_rad, distance, np.inf)
        neighbour = distance.argmin(1)
        row = np.arange(len(reference))
        axis = away[row, neighbour]
        length = np.hypot(axis[:, 0], axis[:, 1])
        # A star without a neighbour keeps the axes of the image.
        alone = length <= self.buffer_rad
        axis = np.where(alone[:, None], [1.0, 0.0], axis / np.where(alone, 1, length)[:, None])
        along = away[..., 0] * axis[:, :1] + away[..., 1] * axis[:, 1:]
        across = away[..., 1] * axis[:, :1] - away[..., 0] * axis[:, 1:]
        # The reference star stands in the middle of a cell, so that its neighbour on the
        # x axis does not stand on the border of two.
        centre = self._cells // 2 + 0.5
        x = np.floor(along / self._cell + centre).astype(int)
        y = np.floor(across / self._cell + centre).astype(int)
        k, n = np.nonzero((x >= 0) & (x < self._cells) & (y >= 0) & (y < self._cells))
        cells = np.zeros((len(reference), self._cells ** 2), np.float32)
        cells[k, y[k, n] * self._cells + x[k, n]] = 1
        return cells, neighbour

    def _decide_with_prior(self, centroids: Centroids, field: FieldStars, observed: np.ndarray,
                           predicted: PredictedField, votes: np.ndarray,
                           prior: AttitudePrediction) -> Identification:
        """Return the answer that the recognised stars and the prediction agree on."""
        options = self.options
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = prior.covariance_sensor
        covariance[3, 3] = (self.scale_error / options.tolerance_sigmas) ** 2
        verifier = PriorVerifier(observed, field.sigma_rad, predicted.place, predicted.inside,
                                 covariance, options.tolerance_sigmas, self._area)
        found = verifier.verify(votes, self.places.crowded[predicted.star],
                                options.false_alarm_max)
        recognised = f'{np.count_nonzero(votes >= 0)} of {len(field)} stars are recognised'
        if found is None:
            return self.nothing(centroids, 'no_candidate',
                                f'{recognised}, none where the prediction has it')
        known = found.row >= 0
        star = np.where(known, predicted.star[found.row], -1)
        if found.contradicted:
            return self.nothing(centroids, 'ambiguous', f'{recognised}, and contradict each other',
                                found.chance)
        if found.chance > options.false_alarm_max:
            return self.nothing(
                centroids, 'no_candidate', f'{recognised}, {np.count_nonzero(known)} stand where '
                'the prediction has them: that may be chance', found.chance)
        tangent = observed[known] / found.focal_ratio
        try:
            attitude = estimate_attitude(
                np.column_stack([tangent, np.ones(len(tangent))]),
                self.places.direction[star[known]], field.sigma_rad[known])
        except AttitudeError as error:
            return self.nothing(centroids, 'no_candidate', str(error), found.chance)
        residual_px = np.full(len(field), np.nan)
        residual_px[known] = attitude.residual_rad / self.camera.pixel_rad
        return self.answer(centroids, field, Match(
            star, residual_px, attitude, found.focal_ratio, found.chance))


class RecursiveIdentifier:
    """
    Extended-grid identification from frame to frame, with the gyro in between.

    condition says in words what the last frame was identified with.
    """

    def __init__(self, identifier: ExtendedGridIdentifier,
                 gyro: GyroErrorOptions = GyroErrorOptions()) -> None:
        self._identifier = identifier
        self._propagator = AttitudePropagator(gyro)
        self.condition = 'no frame yet'

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Take the rate (3,) about sensor axes measured up to a time; False if unusable."""
        return self._propagator.add_rate(stamp_ns, rate_rad_s)

    @property
    def has_rates(self) -> bool:
        """Whether there is a gyro: without any rate each frame is identified lost-in-space."""
        return self._propagator.has_rates

    def identify(self, stamp_ns: int, centroids: Centroids) -> Identification:
        """
        Identify the frame of a time, later than that of the frame before.

        A frame without an answer leaves the prediction as it is, which ages until the grid
        cannot use it any more: then the next frames are identified lost-in-space.
        """
        prior = self._propagator.predict(stamp_ns)
        if prior is not None and not self._identifier.captures(prior):
            self._propagator.forget_attitude()
            prior = None
        result = self._identifier.identify(centroids, prior)
        if prior is not None and result.attitude is None:
            # A prediction that is wrong by more than it knows must not hide a field that
            # needs none.
            lost = self._identifier.identify(centroids)
            if lost.attitude is not None:
                result, prior = lost, None
        self.condition = self._condition(prior)
        if result.attitude is not None:
            attitude = result.attitude.quaternion, result.attitude.covariance_sensor
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

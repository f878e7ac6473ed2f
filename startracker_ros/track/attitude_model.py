"""One rotation moves all stars: a single filter of attitude and rate, fed by all of them."""

from collections.abc import Iterator
import math

import numpy as np
from startracker_ros.attitude.attitude_state import AttitudeState
from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.attitude.gyro import Gyro
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.onboard import StarPlaces
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.track.correction import correct, Correction, on_image
from startracker_ros.track.model import Fix, Followed, rate_between, StarModel
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.rotation_fit import median, RAYLEIGH_MEDIAN, RotationFit

MANOEUVRES = (10.0, 100.0, 1000.0)
"""Accelerations tried one after the other, in units of acceleration_deg_s2, when the stars are
not where they should be: a manoeuvre is followed, and a steady turn filtered, by one option.
The state before is doubted as much, as a manoeuvre shows some frames after it has begun."""

MANOEUVRE_FRAMES = 10
"""Frames for which a manoeuvre is thought to go on."""

SURPRISE = 25.9
"""Squared Mahalanobis distance of a turn from its prediction that chance exceeds once in a
hundred thousand frames (chi-square, 3 degrees of freedom): more is a manoeuvre, or a wrong
gyro. An alarm without reason costs what a long steady turn has taught the filter."""

MEMORY = 0.2
MEAN_SURPRISE = 25.9 * MEMORY / (2 - MEMORY)
"""The same for the mean of the turns that were not foreseen, in which the newest frame has this
weight: what is too small to surprise in one frame, but has the same direction in many, is a
manoeuvre as well."""

GYRO_SILENCE_S = 1.0
"""After so long without a rate the gyro counts as gone, and the rate is that of the stars."""


class AttitudeModel(StarModel):
    """
    Attitude and body rate, or with a gyro attitude and its drift, predict every star.

    gyro_trouble says in words why the rates of a gyro are not used, empty when all is well.
    """

    def __init__(self, camera: Camera, places: StarPlaces, options: TrackerOptions,
                 gyro: Gyro) -> None:
        super().__init__(camera, places, options)
        self._gyro = gyro
        across, roll = options.acceleration_deg_s2, options.roll_acceleration_deg_s2
        self._acceleration_rad_s2 = np.radians([across, across, roll])
        self.gyro_trouble = ''

    def start(self, fix: Fix, first: Fix) -> None:
        dt_s = (fix.stamp_ns - first.stamp_ns) * 1e-9
        attitude = fix.attitude.covariance_sensor * fix.scale ** 2
        covariance = np.zeros((9, 9))
        covariance[:3, :3] = attitude
        covariance[:3, 3:6] = covariance[3:6, :3] = attitude / dt_s
        covariance[3:6, 3:6] = (
            attitude + first.attitude.covariance_sensor * first.scale ** 2) / dt_s ** 2
        rate = rate_between(first.stamp_ns, first.attitude, fix.stamp_ns, fix.attitude)
        self._state = AttitudeState(
            fix.stamp_ns, fix.attitude.quaternion, rate, np.zeros(3), covariance
        ).with_new_drift(self._gyro.drift_sigma_rad_s)
        self.uses_gyro = False
        self._gyro_agreed = 0
        self._scale = _ErrorScale(fix.scale)
        self._unforeseen = np.zeros(3)
        self._level, self._manoeuvre_frames = 1.0, 0

    def follow(self, stamp_ns: int, frame: Centroids) -> Followed:
        nominal: tuple[bool, AttitudeState, Correction] | None = None
        dark = self.is_dark(frame)
        icrf, uv = self._places.direction[self.bank.place], np.ascontiguousarray(frame.uv)
        variance = (self._scale.value * self.sigma_px(frame)) ** 2
        for uses_gyro, level, predicted in self._predictions(stamp_ns, dark):
            correction = correct(
                self._camera.lens, icrf, self.bank.confirmed, self._options.min_stars, predicted,
                uv, variance, self._chances)
            fit = self._judge(correction)
            mean = self._unforeseen + MEMORY * (correction.unforeseen - self._unforeseen)
            if fit is None or nominal is None and mean @ mean > MEAN_SURPRISE:
                nominal = nominal or (uses_gyro, predicted, correction)
                if dark:
                    break
                continue
            if nominal:
                self._unforeseen = np.zeros(3)
                self._level, self._manoeuvre_frames = level, MANOEUVRE_FRAMES
            else:
                self._unforeseen = mean
                self._manoeuvre_frames = max(0, self._manoeuvre_frames - 1)
            before_ns = self._state.stamp_ns
            self._go_to(correction.state, uses_gyro)
            self._take(correction, correction.probability, frame, variance)
            self._scale.add(fit)
            if not self.uses_gyro:
                self._consider_gyro(before_ns, level)
            return Followed(True, fit, correction.unclaimed)
        assert nominal is not None, 'there is always a prediction'
        # Go on by the prediction alone: no star is taken for seen.
        uses_gyro, predicted, correction = nominal
        self._go_to(predicted, uses_gyro)
        self._take(correction, np.ones((len(correction.predicted), 1)), Centroids.empty(),
                   np.empty(0))
        return Followed(False, None, correction.unclaimed)

    def _predictions(self, stamp_ns: int, dark: bool
                     ) -> Iterator[tuple[bool, float, AttitudeState]]:
        """
        Yield whether a gyro is used, the acceleration, and the attitude that they predict.

        The first is what is expected, the others are manoeuvres.
        """
        state, gyro = self._state, self._gyro
        density = self._acceleration_rad_s2 ** 2 * (stamp_ns - state.stamp_ns) * 1e-9
        level = self._level if self._manoeuvre_frames else 1.0
        with_gyro = self.uses_gyro and gyro.silent_s(stamp_ns) <= GYRO_SILENCE_S
        if with_gyro:
            # In the dark, or in a manoeuvre, the body may do what it likes.
            if dark or level > 1:
                yield True, level, gyro.carry(state, stamp_ns)
            else:
                yield True, level, gyro.support(state, stamp_ns, density)
            yield True, MANOEUVRES[0], gyro.carry(state.less_sure(MANOEUVRES[0]), stamp_ns)
        else:
            yield False, level, state.by_inertia(
                stamp_ns, level ** 2 * density, gyro.drift_density)
        for more in MANOEUVRES:
            if with_gyro or more >= level:
                yield False, more, state.less_sure(more).by_inertia(
                    stamp_ns, more ** 2 * density, gyro.drift_density)

    def _judge(self, correction: Correction) -> RotationFit | None:
        """Return what the stars agree on, None unless enough do, and are where they should be."""
        unforeseen, inlier, state = correction.unforeseen, correction.inlier, correction.state
        if not correction.agreed or unforeseen @ unforeseen > SURPRISE:
            return None
        distance, normalised = correction.distance[inlier], correction.normalised[inlier]
        attitude = AttitudeEstimate(
            state.quaternion, state.covariance[:3, :3], len(distance),
            distance * self._camera.pixel_rad, float(normalised @ normalised))
        fit = RotationFit(attitude, correction.normalised, self._scale.value, inlier,
                          math.sqrt(distance @ distance / len(distance)))
        stars = int(np.count_nonzero(self.bank.confirmed & correction.inside))
        good = fit.is_good(stars, self._options.min_stars, self._options.max_residual_px)
        return fit if good else None

    def _take(self, correction: Correction, probability: np.ndarray, frame: Centroids,
              variance: np.ndarray) -> None:
        """Keep the tracks in the image, as they were seen, at the places that the state gives."""
        bank = self.bank.select(correction.inside).observed(
            correction.predicted, probability, frame, variance)
        self.bank = bank.placed(*on_image(
            self._camera.lens, self._places.direction[bank.place], self._state))

    def _go_to(self, state: AttitudeState, uses_gyro: bool) -> None:
        """Take a state; a gyro that the stars do not need has told nothing of its drift."""
        if self.uses_gyro and not uses_gyro:
            self._gyro_agreed = 0
            state = state.with_new_drift(self._gyro.drift_sigma_rad_s)
        self._state, self.uses_gyro = state, uses_gyro

    @property
    def rate_rad_s(self) -> np.ndarray:  # type: ignore[override]  # it stands in the state
        return self._state.rate

    @property
    def rate_covariance(self) -> np.ndarray:  # type: ignore[override]  # the same
        return self._state.covariance[3:6, 3:6]

    def _consider_gyro(self, before_ns: int, level: float) -> None:
        """
        Use the gyro once it has agreed with the stars for some frames, and say if it does not.

        A wrong unit or axis gives other rates than the stars have: such a gyro would lose them.
        """
        state, gyro = self._state, self._gyro
        if gyro.silent_s(state.stamp_ns) > GYRO_SILENCE_S:
            self._gyro_agreed, self.gyro_trouble = 0, ''
            return
        measured, variance = gyro.mean_rate(before_ns, state.stamp_ns)
        manoeuvre = level * self._acceleration_rad_s2 * (state.stamp_ns - before_ns) * 1e-9
        offset = measured - self.rate_rad_s
        covariance = self.rate_covariance + np.eye(3) * (
            variance + manoeuvre ** 2 + gyro.drift_sigma_rad_s ** 2)
        if offset @ np.linalg.solve(covariance, offset) > SURPRISE:
            self._gyro_agreed = 0
            self.gyro_trouble = (
                f'imu says {_deg_s(measured)} deg/s, the stars {_deg_s(self.rate_rad_s)} about '
                'x, y, z: is it in rad/s, on the axes of the sensor, and gyro_drift_deg_h right?')
            return
        self._gyro_agreed += 1
        if self._gyro_agreed < self._options.confirm_frames:
            return
        self.uses_gyro, self.gyro_trouble = True, ''


class _ErrorScale:
    """
    How many times larger than promised the errors of centroids are: a lens not calibrated.

    Never below one, and above it only when that is no chance.
    """

    def __init__(self, scale: float) -> None:
        self._ratio = self.value = scale
        self._frames = 1

    def add(self, fit: RotationFit) -> None:
        """Take the distances of a good frame."""
        ratio = self.value * median(fit.normalised[fit.inlier]) / RAYLEIGH_MEDIAN
        self._frames = min(self._frames + 1, 20)
        self._ratio += (ratio - self._ratio) / self._frames
        self.value = float(self._ratio) if self._ratio > 1.15 else 1.0


def _deg_s(rate_rad_s: np.ndarray) -> str:
    return ' '.join(f'{value:.4f}' for value in np.degrees(rate_rad_s))

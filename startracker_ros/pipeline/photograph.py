"""Attitude and lens of a photograph of a camera that nobody has calibrated."""

from dataclasses import replace

import numpy as np
from startracker_ros.astro.aberration import apparent_directions
from startracker_ros.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.astro.observer_motion import AT_REST, Observer
from startracker_ros.attitude.result import AttitudeEstimate
from startracker_ros.calibration.learnt_lens import learn_lens, LearntLens
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.centroid.photograph import Detections
from startracker_ros.identify.identification import Identification, IdentificationOptions
from startracker_ros.identify.ladder import Attempt, ATTEMPTS, LadderIdentifier
from startracker_ros.maths.rotation import matrix_from_quaternion, quaternion_from_matrix
from startracker_ros.pipeline.solution import MIN_STARS, Solution

_COARSEST_PIXEL_DEG = 0.3
_SMALL_RAD = 1e-4  # step from the middle of an image towards its edge


class PhotographSolver:
    """Solves photographs of one nominal camera at one epoch; the lens is fitted to each."""

    def __init__(self, camera: Camera, epoch_year: float,
                 options: IdentificationOptions = IdentificationOptions(),
                 observer: Observer = AT_REST) -> None:
        self._camera = camera
        self._options = options
        self._observer = observer
        self._pixel_deg = float(np.degrees(camera.pixel_rad))
        self._ladder = (LadderIdentifier(camera, epoch_year, options)
                        if self._pixel_deg <= _COARSEST_PIXEL_DEG else None)

    def solve(self, image: np.ndarray) -> Solution:
        """Return the attitude and the lens of image (H, W) uint8 or uint16, or why not."""
        detections = Detections(image)
        if len(detections.extraction.centroids) < MIN_STARS:
            most = max(detections, key=len, default=Centroids.empty())
            if len(most) < MIN_STARS:
                extraction = detections.extraction
                return Solution.none(self._camera, most, extraction.status, extraction.reason)
        if self._ladder is None:
            return Solution.none(
                self._camera, detections.extraction.centroids, 'too_small', f'a pixel is '
                f'{self._pixel_deg:.2g} deg wide: more than {_COARSEST_PIXEL_DEG} resolves no '
                'stars')
        rejected = ''
        for attempt in self._ladder.identify(detections):
            if attempt.identification.attitude is None:
                continue
            lens = learn_lens(attempt, self._camera, self._options.fov_error_percent / 100)
            if not lens.rejected:
                found = _identification(attempt, lens, self._observer)
                return Solution(attempt.centroids, found, lens.camera, lens.sigma_px)
            rejected = lens.rejected
        most = max(detections, key=len)
        reason = rejected or detections.extraction.reason or (
            f'{len(most)} spots, no lens of about {np.degrees(self._camera.fov_x_rad):.3g} deg '
            'explains them as stars: another --fov-deg, a mirrored image, or no night sky')
        return Solution.none(self._camera, most, 'no_candidate', reason)


def _identification(attempt: Attempt, lens: LearntLens, observer: Observer) -> Identification:
    """Return the stars of the fitted lens."""
    onboard, known = attempt.identifier.onboard, lens.star >= 0
    hip = np.where(known, onboard.hip[lens.star], 0).astype(np.int32)
    magnitude = np.where(known, onboard.magnitude[lens.star], np.nan)
    false_alarm = attempt.identification.false_alarm_probability * ATTEMPTS
    return Identification('identified', f'{lens.matched} stars', hip, magnitude,
                          lens.residual_px, _apparent(lens.attitude, observer), lens.focal_ratio,
                          min(false_alarm, 1.0))


def _apparent(attitude: AttitudeEstimate, observer: Observer) -> AttitudeEstimate:
    """Return an attitude that was fitted to directions without aberration, with it."""
    if observer.vantage is None:
        return attitude
    axes = matrix_from_quaternion(attitude.quaternion)
    z, y = apparent_directions(
        np.stack([axes[:, 2], axes[:, 2] + _SMALL_RAD * axes[:, 1]]), observer.vantage)
    y = y - z * (z @ y)
    y /= np.linalg.norm(y)
    sigma_rad = observer.velocity_sigma_m_s / SPEED_OF_LIGHT_M_S
    return replace(
        attitude, quaternion=quaternion_from_matrix(np.stack([np.cross(y, z), y, z], -1)),
        covariance_sensor=attitude.covariance_sensor + sigma_rad ** 2 * np.diag([1.0, 1.0, 0.0]))

"""Where the stars in view will be."""

import numpy as np
from startracker_ros.attitude.estimate import AttitudeEstimate
from startracker_ros.centroid.prediction import PredictedStars
from startracker_ros.track.in_view import StarsInView
from startracker_ros.track.motion_models import image_flows
from startracker_ros.track.options import TrackerOptions

BORDER_PX = 5.0  # from the edge of the image, where stars are seen in full
SPARE_STARS = 1.5  # per star that is followed: some are blended or too faint


def visible_stars(stars: StarsInView, attitude: AttitudeEstimate, rate_rad_s: np.ndarray,
                  faintest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (N, 2) and velocities (N, 2) px/s of single stars up to a magnitude."""
    index, sensor, uv = stars.of(attitude)
    bright = np.searchsorted(stars.onboard.magnitude[index], faintest, side='right')
    index, sensor, uv = index[:bright], sensor[:bright], uv[:bright]
    chosen = stars.camera.contains(uv, BORDER_PX) & ~stars.onboard.crowded[index]
    flow = image_flows(stars.camera.lens, sensor[chosen])
    return uv[chosen], flow @ rate_rad_s


def predict_stars(stars: StarsInView, stamp_ns: int, attitude: AttitudeEstimate,
                  rate_rad_s: np.ndarray, options: TrackerOptions) -> PredictedStars:
    """Return the brightest stars in the image at an attitude, and how they move."""
    index, sensor, uv = stars.of(attitude)
    inside = np.flatnonzero(stars.camera.contains(uv)
                            & (stars.onboard.magnitude[index] <= options.magnitude_limit))
    inside = inside[:int(SPARE_STARS * options.max_stars)]
    flow = image_flows(stars.camera.lens, np.ascontiguousarray(sensor[inside]))
    covariance = flow @ attitude.covariance_sensor @ np.swapaxes(flow, 1, 2)
    return PredictedStars(
        stamp_ns, uv[inside], flow @ rate_rad_s,
        np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2),
        stars.onboard.hip[index[inside]])

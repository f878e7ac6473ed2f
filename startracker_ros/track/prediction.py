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
    index, sensor, uv = _in_image(stars, attitude, faintest, BORDER_PX)
    single = ~stars.sky.crowded(index)
    flow = image_flows(stars.camera.lens, sensor[single])
    return uv[single], flow @ rate_rad_s


def predict_stars(stars: StarsInView, stamp_ns: int, attitude: AttitudeEstimate,
                  rate_rad_s: np.ndarray, options: TrackerOptions) -> PredictedStars:
    """Return the brightest stars in the image at an attitude, and how they move."""
    most = slice(int(SPARE_STARS * options.max_stars))
    index, sensor, uv = (column[most] for column in _in_image(
        stars, attitude, options.magnitude_limit, 0.0))
    flow = image_flows(stars.camera.lens, sensor)
    covariance = flow @ attitude.covariance_sensor @ np.swapaxes(flow, 1, 2)
    return PredictedStars(
        stamp_ns, uv, flow @ rate_rad_s,
        np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2),
        stars.onboard.hip[index])


def _in_image(stars: StarsInView, attitude: AttitudeEstimate, faintest: float, border_px: float
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what stars.of() does, of the stars up to a magnitude inside a border."""
    index, sensor, uv = stars.of(attitude)
    bright = np.searchsorted(stars.onboard.magnitude[index], faintest, side='right')
    inside = stars.camera.contains(uv[:bright], border_px)
    return index[:bright][inside], sensor[:bright][inside], uv[:bright][inside]

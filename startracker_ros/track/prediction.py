"""Where the stars in view will be."""

import numpy as np
from startracker_ros.centroid.prediction import PredictedStars
from startracker_ros.track.in_view import StarsInView
from startracker_ros.track.motion_models import image_flows
from startracker_ros.track.options import TrackerOptions
from startracker_ros.track.tracks import TrackedAttitude

SPARE_STARS = 1.5  # per star that is followed: some are blended or too faint


def predict_stars(stars: StarsInView, stamp_ns: int, tracked: TrackedAttitude,
                  options: TrackerOptions) -> PredictedStars:
    """Return the brightest stars in the image at an attitude, and how they move."""
    index, sensor, uv = stars.of(tracked.attitude)
    inside = np.flatnonzero(stars.camera.contains(uv)
                            & (stars.onboard.magnitude[index] <= options.magnitude_limit))
    inside = inside[:int(SPARE_STARS * options.max_stars)]
    flow = image_flows(stars.camera.lens, np.ascontiguousarray(sensor[inside]))
    covariance = flow @ tracked.attitude.covariance_sensor @ np.swapaxes(flow, 1, 2)
    return PredictedStars(
        stamp_ns, uv[inside], flow @ tracked.rate_rad_s,
        np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2),
        stars.onboard.hip[index[inside]])

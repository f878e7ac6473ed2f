"""Compile what is compiled at its first use, so that no node has to wait for it."""

import numpy as np

from startracker_ros.attitude.estimate import estimate_attitude
from startracker_ros.camera import Camera
from startracker_ros.catalog.places import camera_places
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.centroid.extraction import CentroidExtractor, ExtractionOptions
from startracker_ros.identify.identification import IdentificationOptions, METHODS
from startracker_ros.identify.methods import make_identifier
from startracker_ros.locate.location import locate
from startracker_ros.locate.orbit import propagate
from startracker_ros.locate.sight import sight
from startracker_ros.rotation import quaternion_from_pointing
from startracker_ros.sky.detector import Detector
from startracker_ros.sky.star_lists import random_attitude, star_list
from startracker_ros.track.options import MODELS, TrackerOptions
from startracker_ros.track.tracker import StarTracker


def warm_up() -> None:
    """Let every method see something: extraction an image, identification a simulated field.

    The field is tracked, one attitude estimated, one image rendered, one target located, too.
    """
    for method in ('gaussian', 'thresholded'):
        CentroidExtractor(ExtractionOptions(method=method, threshold='iterative')).warm_up()
    camera = Camera.from_fov(512, 512, 20.0)
    catalog = load_catalog()
    places = camera_places(catalog, camera, 2026.0, 5.0)
    rng = np.random.default_rng(1)
    centroids, hip = star_list(places, camera, random_attitude(rng), 0.1, rng)
    for method in METHODS:
        options = IdentificationOptions(method=method, magnitude_limit=5.0)
        make_identifier(camera, 2026.0, options, catalog).identify(centroids)
    for model in MODELS:
        tracker = StarTracker(camera, places, TrackerOptions(model=model))
        # A gyro is believed after some frames only.
        for stamp_ns in range(0, 1_000_000_000, 100_000_000):
            tracker.add_rate(stamp_ns, np.zeros(3))
            tracker.update(stamp_ns, centroids)
            tracker.identified(stamp_ns, centroids, hip)
    estimate_attitude(np.eye(3), np.eye(3), np.ones(3))
    detector = Detector(camera)
    detector.render(centroids.uv, np.full(len(centroids.uv), 5.0), rng)
    detector.render(np.zeros((0, 2)), np.zeros(0), rng)
    locate(*(sight(camera, np.zeros(2), 0.1,
                   quaternion_from_pointing(*np.radians([aside, 0.0, 0.0])), np.eye(3),
                   [0.0, -1e4 * aside, 0.0], np.eye(3)) for aside in (-10.0, 10.0)))
    propagate([7e6, 0.0, 0.0], [0.0, 7.5e3, 0.0], 1.0)


if __name__ == '__main__':
    warm_up()

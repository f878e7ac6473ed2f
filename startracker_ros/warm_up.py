"""
Compile what is compiled at its first use, so that no node has to wait for it.

python -m startracker_ros.warm_up [FOLDER] copies the machine code into a folder as well, which the
build does for the install.
"""

from concurrent.futures import ProcessPoolExecutor
import hashlib
from multiprocessing import get_context
import os
from pathlib import Path
import sys

import numba
from numba.core.registry import cpu_target
import numpy as np
from startracker_ros.astro.observer_motion import ObserverMotion
from startracker_ros.attitude.estimate import estimate_attitude
from startracker_ros.attitude.star_distances import star_distances
from startracker_ros.catalog.apparent import ApparentCatalog
from startracker_ros.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.catalog.stars import load_catalog
from startracker_ros.centroid.centroids import Centroids
from startracker_ros.centroid.extraction import CentroidExtractor, ExtractionOptions
from startracker_ros.centroid.synthetic_field import (
    synthetic_field, WARM_UP_CAMERA as CAMERA, WARM_UP_EPOCH_YEAR as EPOCH_YEAR)
from startracker_ros.identify.identification import IdentificationOptions, METHODS
from startracker_ros.identify.methods import make_identifier
from startracker_ros.locate.line_of_sight import line_of_sight
from startracker_ros.locate.location import locate
from startracker_ros.machine_code import copy_code, imported_code, machine_code_folder
from startracker_ros.maths.rotation import quaternion_from_pointing
from startracker_ros.pipeline.cloud_rows import centroid_rows, centroids_from_rows
from startracker_ros.sky.detector import Detector, DetectorOptions
from startracker_ros.track.in_view import StarsInView
from startracker_ros.track.new_stars import match_new_stars
from startracker_ros.track.options import MODELS, TrackerOptions
from startracker_ros.track.target import TargetTracker
from startracker_ros.track.tracker import StarTracker


def _field() -> tuple[OnboardCatalog, Centroids, np.ndarray]:
    """Return an on-board catalogue, the centroids of a field, and their hip (N,)."""
    onboard = onboard_catalog(load_catalog(), CAMERA, EPOCH_YEAR, 5.0)
    return onboard, *synthetic_field(onboard, CAMERA)


def extraction() -> None:
    """Extract from an image."""
    for method in ('gaussian', 'thresholded'):
        CentroidExtractor(ExtractionOptions(method=method, threshold='iterative')).warm_up()


def identification() -> None:
    """Identify a field by every method."""
    for method in METHODS:
        options = IdentificationOptions(method=method, magnitude_limit=5.0)
        make_identifier(CAMERA, EPOCH_YEAR, options, load_catalog()).warm_up()


def tracking() -> None:
    """Track a field by every model, estimate an attitude, look for new stars and a target."""
    onboard, centroids, _ = _field()
    for model in MODELS:
        StarTracker(CAMERA, onboard, TrackerOptions(model=model)).warm_up()
    attitude = estimate_attitude(np.eye(3), np.eye(3), np.ones(3))
    star_distances(CAMERA.lens, attitude.quaternion, np.eye(3), np.zeros((3, 2)))
    centroids_from_rows(centroid_rows(centroids, CAMERA))
    sky = ApparentCatalog(onboard)
    match_new_stars(
        StarsInView(CAMERA, sky), attitude, centroids, centroids.sigma_px, 0.0, 1.0)
    TargetTracker(CAMERA, sky).update(1, attitude, centroids)


def rendering() -> None:
    """Render a field, and an image without stars."""
    _, centroids, _ = _field()
    detector, rng = Detector(CAMERA), np.random.default_rng(1)
    detector.render(centroids.uv, np.full(len(centroids.uv), 5.0), rng)
    detector.render(np.zeros((0, 2)), np.zeros(0), rng)
    artefacts = DetectorOptions(blooming=True, cosmic_ray_hits_cm2_s=1.0)
    Detector(CAMERA, artefacts).expose(
        centroids.uv, np.full(len(centroids.uv), 5.0), rng, trails=np.array([[0., 0., 1., 0.]]))


def location() -> None:
    """Locate a target."""
    first, second = (
        line_of_sight(CAMERA, np.zeros(2), 0.1,
                      quaternion_from_pointing(np.radians(aside), 0.0, 0.0), np.eye(3),
                      np.array([0.0, -1e4 * aside, 0.0]), np.eye(3)) for aside in (-10.0, 10.0))
    locate(first, second)
    ObserverMotion().warm_up()


# The longest first, so that two cores end together.
STAGES = (identification, extraction, tracking, rendering, location)


def main(arguments: list[str] = sys.argv[1:]) -> None:
    """Warm all stages up, on all cores at once, unless that was done for the same sources."""
    done = Path(machine_code_folder(), f'complete-{_digest()}')
    if not done.exists():
        with ProcessPoolExecutor(os.cpu_count(), get_context('spawn')) as pool:
            for stage in [pool.submit(stage) for stage in STAGES]:
                stage.result()
        if machine_code_folder():
            done.touch()
    for folder in arguments:
        copy_code(Path(folder))


def _digest() -> str:
    """Return a digest of the sources, the compiler and the processor."""
    made_for = (sorted(imported_code()), numba.__version__, sys.version,
                cpu_target.target_context.codegen().magic_tuple())
    return hashlib.sha256(repr(made_for).encode()).hexdigest()[:16]


if __name__ == '__main__':
    main()

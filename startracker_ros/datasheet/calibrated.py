"""The camera as its own calibration by stars knows it: the source of field-of-view errors."""

import numpy as np
from startracker_ros.astro.aberration import vantage_near_earth
from startracker_ros.calibration.adjustment import CalibrationError
from startracker_ros.calibration.estimate import calibrate
from startracker_ros.calibration.matching import View
from startracker_ros.camera.model import Camera
from startracker_ros.catalog.deep import camera_catalog
from startracker_ros.catalog.onboard import onboard_catalog
from startracker_ros.datasheet.instrument import EPOCH_YEAR, Instrument, ORBIT, START_NS
from startracker_ros.datasheet.motions import Pointings
from startracker_ros.maths.rotation import random_attitude
from startracker_ros.pipeline.pipeline import Pipeline
from startracker_ros.sky.detector import DetectorOptions
from startracker_ros.sky.simulator import SkySimulator

IMAGES = 20


def calibrated_instrument(lens: Camera, detector: DetectorOptions, seed: int) -> Instrument:
    """
    Return the instrument whose star tracker uses the camera that IMAGES simulated images give.

    CalibrationError where the images do not determine a camera.
    """
    rng = np.random.default_rng(seed)
    motion = Pointings(np.array([random_attitude(rng) for _ in range(IMAGES)]),
                       np.zeros((IMAGES, 3)))
    catalog = camera_catalog(lens)
    simulator = SkySimulator(lens, motion, catalog, EPOCH_YEAR, detector_options=detector,
                             seed=seed)
    pipeline, views = Pipeline(lens, EPOCH_YEAR), []
    for second in range(IMAGES):
        image = simulator.frame(float(second)).image
        centroids = pipeline.extraction.extractor.extract(image).centroids
        found, _ = pipeline.identification.identify(START_NS + second * 10 ** 9, centroids)
        if found.attitude is not None:
            views.append(View(centroids, found.attitude.quaternion, vantage_near_earth(
                EPOCH_YEAR, ORBIT.at(float(second))[1])))
    if not views:
        raise CalibrationError(
            f'none of {IMAGES} simulated images of this camera is identified: too few stars in '
            'the field, or too little light; look at `startracker design`')
    onboard = onboard_catalog(catalog, lens, EPOCH_YEAR)
    return Instrument(lens, calibrate(views, lens, onboard).camera, detector)

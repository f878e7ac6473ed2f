# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The camera as its own calibration by stars knows it: the source of bias and field-of-view errors.

A calibration is a random result too. Its errors are followed through the attitude without images:
catalogue stars are projected by the lens and solved with the calibrated camera.
"""

from collections.abc import Sequence

import numpy as np
from startracker_ros.core.astro.aberration import state_near_earth
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.calibration.adjustment import CalibrationError
from startracker_ros.core.calibration.estimate import calibrate
from startracker_ros.core.calibration.matching import View
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.centroid.extraction import ExtractionOptions
from startracker_ros.core.maths.rotation import attitude_error, conjugate, random_attitude, rotate
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.datasheet.bounds import limiting_magnitude, motion_px, star_image
from startracker_ros.tools.datasheet.instrument import (
    EPOCH_YEAR, Instrument, ORBIT, Pointings, START_NS)

IMAGES = 20

_NEEDED_STARS = 4


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
    pipeline, views = StarTracker(lens, EPOCH_YEAR), []
    for second in range(IMAGES):
        image = simulator.frame(float(second)).image
        centroids = pipeline.extraction.extractor.measure(image).centroids
        found, _ = pipeline.identification.identify(START_NS + second * 10 ** 9, centroids)
        if found.attitude is not None:
            views.append(View(centroids, found.attitude.quaternion, state_near_earth(
                EPOCH_YEAR, ORBIT.at(float(second))[1])))
    if not views:
        raise CalibrationError(
            f'none of {IMAGES} simulated images of this camera is identified: too few stars in '
            'the field, or too little light; look at `startracker design`')
    onboard = onboard_catalog(catalog, lens, EPOCH_YEAR)
    return Instrument(lens, calibrate(views, lens, onboard).camera, detector)


def calibration_errors(lens: Camera, detector: DetectorOptions, rates_deg_s: Sequence[float],
                       fields: int, calibrations: int, seed: int) -> np.ndarray:
    """Return the errors (calibrations, rates, fields, 3) rad of so many calibrations."""
    return np.array([field_errors(calibrated_instrument(lens, detector, seed + number),
                                  rates_deg_s, fields, seed + number)
                     for number in range(calibrations)])


def field_errors(instrument: Instrument, rates_deg_s: Sequence[float], fields: int, seed: int
                 ) -> np.ndarray:
    """
    Return the errors (rates, fields, 3) rad about sensor axes that the calibration alone makes.

    The stars are those found at each rate, weighted by their Cramer-Rao bounds; NaN for a field
    with fewer than four.
    """
    lens, detector = instrument.lens, instrument.detector
    rng = np.random.default_rng(seed)
    attitudes = [random_attitude(rng) for _ in range(fields)]
    errors = np.full((len(rates_deg_s), fields, 3), np.nan)
    for number, rate_deg_s in enumerate(rates_deg_s):
        streak_px = float(np.linalg.norm(
            motion_px(lens, detector, np.radians([rate_deg_s, 0.0, 0.0]))))
        limit = limiting_magnitude(detector, streak_px, ExtractionOptions().threshold_sigma)
        onboard = onboard_catalog(camera_catalog(lens), lens, EPOCH_YEAR, limit)
        flux_e = detector.zero_flux_e_s * detector.exposure_s * 10 ** (-0.4 * onboard.magnitude)
        information = star_image(detector, round(streak_px, 2)).at(flux_e).mean(axis=1)
        sigma_rad = lens.pixel_rad / np.sqrt(information)
        for field, q in enumerate(attitudes):
            star = _stars_of(onboard, lens, q)
            if len(star) >= _NEEDED_STARS:
                seen = lens.project(rotate(conjugate(q), onboard.direction[star]))
                solved = estimate_attitude(instrument.camera.unproject(seen),
                                           onboard.direction[star], sigma_rad[star])
                errors[number, field] = attitude_error(solved.quaternion, q)
    return errors


def _stars_of(onboard: OnboardCatalog, lens: Camera, q: np.ndarray) -> np.ndarray:
    """Return the indices of the brightest stars in the image that have no blended neighbour."""
    near = onboard.within(rotate(q, [0.0, 0.0, 1.0]), lens.corner_angle_rad)
    near = near[~onboard.blended[near]]
    inside = lens.contains(lens.project(rotate(conjugate(q), onboard.direction[near])))
    return near[inside][:ExtractionOptions().max_stars]

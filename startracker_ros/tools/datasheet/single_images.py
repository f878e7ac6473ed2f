# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Errors of the attitude of single images, split as ECSS-E-ST-60-20C Rev. 2 splits them.

Each field of the sky is seen in a few images whose stars are shifted by fractions of pixels to
some pixels. The first one is identified lost in space; then the stars are measured as while they
are tracked: near where they are predicted. Each image is rendered twice, with noise and without,
and the stars found in the noisy one are measured in both. The difference is the temporal noise.
What is left is spatial: its mean in a field is the field-of-view spatial error, of low frequency,
its scatter within the field the pixel spatial error, of high frequency; the mean over all fields
is the bias.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.spatial import cKDTree
from startracker_ros.core.catalog.deep import camera_catalog
from startracker_ros.core.centroid.extraction import Searched
from startracker_ros.core.centroid.streak import Streak
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, multiply, quaternion_from_rotation_vector, random_attitude, rotate)
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.sim.sky.simulator import Frame, SkySimulator
from startracker_ros.tools.datasheet.bounds import attitude_bound, motion_px
from startracker_ros.tools.datasheet.instrument import (
    across_boresight, EPOCH_YEAR, Instrument, Pointings, START_NS)

SHIFTS = 4
"""Images of each field; the first is also searched and identified."""

_SHIFT_PX = 2.0
_MATCH_PX = 3.0
_NEAR_PX = 4.0
_CANDIDATES = 60  # brightest predicted stars; of those found max_stars are used
_NO_ERRORS = np.full((2, 3), np.nan)


@dataclass(frozen=True)
class ImageErrors:
    """
    Errors about sensor axes (F, SHIFTS, 3) in rad of F fields, NaN without an attitude.

    noise is that of the noisy image minus that of the clean one, spatial that of the clean one;
    bound the Cramer-Rao variances. identified (F,) is whether the first image was identified.
    """

    noise: np.ndarray
    spatial: np.ndarray
    bound: np.ndarray
    identified: np.ndarray


@cache
def _pipeline(instrument: Instrument) -> StarTracker:
    return StarTracker(instrument.camera, EPOCH_YEAR)


def image_errors(instrument: Instrument, rate_deg_s: float, fields: int, seed: int
                 ) -> ImageErrors:
    """Return the errors of random fields in turns at a rate across the boresight."""
    motion = _shifted_pointings(instrument, rate_deg_s, fields, seed)
    clean_detector = replace(instrument.detector, noise=False)
    noisy, clean = (
        SkySimulator(instrument.lens, motion, camera_catalog(instrument.lens), EPOCH_YEAR,
                     detector_options=detector, seed=seed)
        for detector in (instrument.detector, clean_detector))
    pipeline = _pipeline(instrument)
    rows = [_field_errors(instrument, pipeline, noisy, clean, range(first, first + SHIFTS))
            for first in range(0, fields * SHIFTS, SHIFTS)]
    return ImageErrors(*map(np.array, zip(*rows)))


def _shifted_pointings(instrument: Instrument, rate_deg_s: float, fields: int, seed: int
                       ) -> Pointings:
    """Return SHIFTS pointings for each of the random fields."""
    rng = np.random.default_rng(seed)
    q = np.repeat([random_attitude(rng) for _ in range(fields)], SHIFTS, axis=0)
    axis = np.repeat(across_boresight(rng, fields), SHIFTS, axis=0)
    shift_px = rng.uniform(-_SHIFT_PX, _SHIFT_PX, (len(q), 3))
    shift_px[::SHIFTS] = 0
    # A roll by the same angle would move the stars by less than a pixel.
    roll = instrument.lens.width / 2 * instrument.lens.pixel_rad
    shift_rad = shift_px * instrument.lens.pixel_rad / [1, 1, roll]
    return Pointings(multiply(q, quaternion_from_rotation_vector(shift_rad)),
                     np.radians(rate_deg_s) * axis)


def _field_errors(instrument: Instrument, pipeline: StarTracker, noisy: SkySimulator,
                  clean: SkySimulator, seconds: range) -> tuple:
    """Return the errors of one field, a row of ImageErrors."""
    errors = np.full((3, SHIFTS, 3), np.nan)
    for shift, second in enumerate(seconds):
        frame = noisy.frame(float(second))
        stamp_ns = START_NS + second * 10 ** 9
        pipeline.motion.add_state(stamp_ns, frame.state.geocentric)
        if not shift:
            extraction, searched = pipeline.extraction.extractor.search(frame.image)
            found, _ = pipeline.identification.identify(stamp_ns, extraction.centroids)
        if searched is None or found.attitude is None:
            return (*errors, False)
        errors[:2, shift] = _errors_of_shift(
            pipeline, stamp_ns, frame, clean.frame(float(second)).image,
            _streak(instrument, frame.state.rate_rad_s), searched)
        errors[2, shift] = np.diag(attitude_bound(
            instrument.lens, instrument.detector, frame.stars.uv,
            frame.flux_dn * instrument.detector.gain_e_per_dn, frame.state.rate_rad_s))
    return (*errors, True)


def _streak(instrument: Instrument, rate_rad_s: np.ndarray) -> Streak:
    """Return the motion in an exposure of a turn across the boresight, as a tracker knows it."""
    camera = instrument.camera
    u_px, v_px = motion_px(camera, instrument.detector, rate_rad_s)
    return Streak(float(u_px), float(v_px), 0.0, (camera.width - 1) / 2, (camera.height - 1) / 2)


def _predicted_stars(pipeline: StarTracker, stamp_ns: int, q: np.ndarray
                     ) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (N, 2) and hip (N,) of the stars that a tracker follows at q (4,)."""
    camera, sky = pipeline.identification.identifier.camera, pipeline.attitude.sky.at(stamp_ns)
    near = sky.onboard.within(rotate(q, [0.0, 0.0, 1.0]), camera.corner_angle_rad)
    near = near[~sky.onboard.blended[near]]
    uv = camera.project(rotate(conjugate(q), sky.direction(near)))
    inside = np.flatnonzero(camera.contains(uv, _NEAR_PX))[:_CANDIDATES]
    return uv[inside], sky.onboard.hip[near[inside]]


def _errors_of_shift(pipeline: StarTracker, stamp_ns: int, frame: Frame, clean: np.ndarray,
                     streak: Streak, searched: Searched) -> np.ndarray:
    """Return the errors (2, 3) by noise and without it: of the same stars, with equal weights."""
    truth, extractor = frame.state.q_icrf_from_sensor, pipeline.extraction.extractor
    expected_px, hip = _predicted_stars(pipeline, stamp_ns, truth)
    radius_px = np.full(len(expected_px), _NEAR_PX)
    noisy, exact = (
        extractor.search_near(image, expected_px, radius_px, searched, streak)[0].centroids
        for image in (frame.image, clean))
    if not (len(noisy) and len(exact)):
        return _NO_ERRORS
    distance_px, index = (np.stack(columns) for columns in zip(*(
        cKDTree(each.uv).query(expected_px) for each in (noisy, exact))))
    both = (distance_px < _MATCH_PX).all(axis=0)
    noisy, uv = noisy.select(index[0, both]), exact.uv[index[1, both]]
    solved = [pipeline.attitude.from_stars(stamp_ns, centroids, hip[both]).attitude
              for centroids in (noisy, replace(noisy, uv=uv))]
    if any(each is None for each in solved):
        return _NO_ERRORS
    with_noise, without = (attitude_error(each.quaternion, truth)
                           for each in solved if each is not None)
    return np.stack([with_noise - without, without])

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The extraction of the native core finds what that in Python finds."""

import csv
import ctypes
from functools import cache

import cv2
from native_core import kernels, ROOT
from native_extraction import (
    camera_of, config_of, Found, image_struct, images, KINDS, NativeTracker)
import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from skies import START_NS
from startracker_ros.core import native
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.extraction import (
    CentroidExtractor, Extraction, ExtractionOptions)
from startracker_ros.core.stages.extraction import ExtractionStage
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator

# The filtered image is float32. Python rounds its sums once, the native core twice, so that the
# noise, in steps of 1/256 DN, may come out a step away; that is 1 % after a wide filter.
NEAR_SIGMAS, NEAR = 0.02, 0.02
IMAGES = images()
PHOTOGRAPHS = [*sorted((ROOT / 'test' / 'data' / 'night-sky-11deg').glob('*.tiff'))[:2],
               *sorted((ROOT / 'test' / 'data' / 'night-sky-6deg').glob('*.png'))[:2]]


def assert_same(expected: Extraction, found: Found) -> None:
    """Assert that an extraction of Python and one of the native core are the same."""
    stars, others = expected.centroids, found.centroids
    assert found.status == expected.status
    assert found.counts == {kind: expected.rejected[kind] for kind in KINDS
                            if kind in expected.rejected}
    assert len(others) == len(stars)
    result = found.extraction
    for name, value in (('background_dn', expected.background_dn),
                        ('noise_dn', expected.noise_dn), ('psf_sigma_px', expected.psf_sigma_px)):
        np.testing.assert_allclose(result[name], value, rtol=NEAR, err_msg=name)
    assert np.isnan(result['streak_u_px']) == (expected.streak is None)
    if expected.streak is not None:
        seen = [result[f'streak_{name}'] for name in ('u_px', 'v_px', 'roll_rad')]
        np.testing.assert_allclose(seen, expected.streak[:3], rtol=NEAR, atol=1e-6)
    np.testing.assert_allclose(
        [result['exposure_least_s'], result['exposure_most_s']], stars.exposure_s, rtol=NEAR)
    if not len(stars):
        return
    for name, value in (('flux_dn', stars.flux), ('snr', stars.snr), ('sigma_px', stars.sigma_px),
                        ('delay_s', stars.delay_s)):
        np.testing.assert_allclose(others[name], value, rtol=NEAR, atol=1e-9, err_msg=name)
    for name, value in (('u_px', stars.uv[:, 0]), ('v_px', stars.uv[:, 1])):
        assert (np.abs(others[name] - value) < NEAR_SIGMAS * stars.sigma_px).all(), name
    for name in ('cov', 'common'):
        covariance = stars.covariance if name == 'cov' else stars.common
        for axes, (i, j) in (('uu', (0, 0)), ('uv', (0, 1)), ('vv', (1, 1))):
            np.testing.assert_allclose(others[f'{name}_{axes}_px2'], covariance[:, i, j],
                                       rtol=2 * NEAR, atol=1e-7, err_msg=f'{name}_{axes}')


def compare(image: np.ndarray, options: ExtractionOptions = ExtractionOptions()) -> None:
    tracker = NativeTracker(image.shape, options)
    assert_same(CentroidExtractor(options).measure(image),
                tracker.extract(START_NS, image, lost=False))
    assert tracker.is_intact


@pytest.mark.parametrize('name', IMAGES)
def test_stars_and_rejected_spots_of_an_image_are_those_of_python(name):
    compare(IMAGES[name])


@pytest.mark.parametrize('path', PHOTOGRAPHS, ids=lambda path: path.stem)
def test_stars_of_a_photograph_are_those_of_python(path):
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    compare(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


@pytest.mark.parametrize('options', [
    ExtractionOptions(threshold='fixed', threshold_dn=200.0),
    ExtractionOptions(threshold='iterative', method='grey'),
    ExtractionOptions(method='squared', max_stars=5),
    ExtractionOptions(method='thresholded', psf_sigma_px=1.1),
    ExtractionOptions(method='binary', line_time_us=20.0, readout_direction='up')],
    ids=lambda options: f'{options.threshold}-{options.method}')
def test_options_do_what_they_do_in_python(options):
    compare(IMAGES['30 stars'], options)


# --- images in turn ---


def recorded(frames, options=ExtractionOptions(), detector=DetectorOptions(),
             artefacts=ArtefactOptions(), rates=lambda index: (0.1, 0.0, 0.0),
             change=lambda index, image: image):
    """Return what an extraction stage in a star tracker was called with, and what it returned."""
    calls, process = [], ExtractionStage.process

    def record(stage, *arguments, **named):
        extraction = process(stage, *arguments, **named)
        calls.append((arguments, named, extraction, stage.windowed))
        return extraction
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ExtractionStage, 'process', record)
        pipeline = StarTracker(CAMERA, 2026.5)
        for index in range(frames):
            motion = motion_from_options(MotionOptions(
                motion='constant_rate', ra_deg=200.0, dec_deg=25.0, rate_deg_s=rates(index)))
            sky = SkySimulator(CAMERA, motion, load_catalog(), 2026.5, detector_options=detector,
                               artefact_options=artefacts, frame_rate_hz=10.0)
            frame = sky.frame(1 + index / 10)
            stamp_ns = START_NS + index * 100_000_000
            pipeline.motion.add_state(stamp_ns, frame.state.geocentric)
            pipeline.process(stamp_ns, change(index, frame.image))
    return calls


def torn_and_repeated():
    before = {}

    def change(index, image):
        image, before[index] = image.copy(), image
        if index in (6, 7):
            return before[5].copy()
        if index == 9:
            image[:200] = before[8][:200]
        return image
    return change


RUNS = {
    'still': {'frames': 16},
    'streaks': {'frames': 14, 'rates': lambda index: (2.5, 0.4, 1.0),
                'detector': DetectorOptions(exposure_s=0.05, motion_smear=True)},
    'hits': {'frames': 10, 'detector': DetectorOptions(
        cosmic_ray_hits_cm2_s=3000.0)},
    'spots': {'frames': 10, 'artefacts': ArtefactOptions(star_like_spots=150)},
    'torn and repeated': {'frames': 14, 'change': torn_and_repeated()},
    'turned away': {'frames': 12, 'rates': lambda index: (0.1 + 15.0 * (index > 6), 0.0, 0.0)}}


@cache
def runs(name):
    return recorded(**RUNS[name])


@pytest.mark.parametrize('name', RUNS)
def test_images_in_turn_are_searched_as_in_python(name):
    tracker, windows = NativeTracker((CAMERA.height, CAMERA.width)), 0
    for index, (arguments, named, expected, windowed) in enumerate(runs(name)):
        try:
            found = tracker.extract(*arguments, **named)
            assert bool(found.extraction['windowed']) == windowed
            assert_same(expected, found)
        except AssertionError as error:
            raise AssertionError(f'image {index} {expected.status}: {error}') from error
        windows += windowed
    assert tracker.is_intact
    assert windows or name == 'turned away'

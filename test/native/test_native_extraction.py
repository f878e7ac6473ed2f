# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The extraction of the native core finds what that in Python finds."""

from functools import cache

import cv2
from native_core import build_module, built, compiler, ROOT
from native_extraction import assert_same, Found, images, NativeTracker, recorded
import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from skies import START_NS
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor, ExtractionOptions
from startracker_ros.core.stages.extraction import ExtractionStage
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator

IMAGES, RECORDED = images(), recorded()
PHOTOGRAPHS = [*sorted((ROOT / 'test' / 'data' / 'night-sky-11deg').glob('*.tiff'))[:2],
               *sorted((ROOT / 'test' / 'data' / 'night-sky-6deg').glob('*.png'))[:2]]


def by_core(image: np.ndarray, options: ExtractionOptions = ExtractionOptions()) -> Found:
    tracker = NativeTracker(image.shape, options)
    found = tracker.extract(START_NS, image, lost=False)
    assert tracker.is_intact
    return found


def compare(image: np.ndarray, options: ExtractionOptions = ExtractionOptions()) -> None:
    assert_same(by_core(image, options),
                Found.by_python(CentroidExtractor(options).measure(image)))


@pytest.mark.parametrize('name', IMAGES)
def test_stars_and_rejected_spots_of_an_image_are_those_recorded(name):
    assert_same(by_core(IMAGES[name]), RECORDED[name])


def test_what_is_recorded_is_what_python_finds():
    assert list(RECORDED) == list(IMAGES)
    for name, image in IMAGES.items():
        assert_same(Found.by_python(CentroidExtractor().measure(image)), RECORDED[name])


def test_the_library_takes_no_memory():
    library = built(build_module().library(compiler()), 'libstartracker.so').read_bytes()
    assert b'st_extract' in library and b'memcpy' in library
    for name in (b'malloc', b'calloc', b'_Znw', b'mmap', b'pthread', b'fopen'):
        assert name not in library, name


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


def calls_of(frames, options=ExtractionOptions(), detector=DetectorOptions(),
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
    return calls_of(**RUNS[name])


@pytest.mark.parametrize('name', RUNS)
def test_images_in_turn_are_searched_as_in_python(name):
    tracker, windows = NativeTracker((CAMERA.height, CAMERA.width)), 0
    for index, (arguments, named, expected, windowed) in enumerate(runs(name)):
        try:
            assert_same(tracker.extract(*arguments, **named),
                        Found.by_python(expected, windowed))
        except AssertionError as error:
            raise AssertionError(f'image {index} {expected.status}: {error}') from error
        windows += windowed
    assert tracker.is_intact
    assert windows or name == 'turned away'

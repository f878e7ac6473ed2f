# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which images are searched as a whole, on simulated images of a turning camera."""

from native_core import filled
import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor, ExtractionOptions
from startracker_ros.core.native import NativeError
from startracker_ros.core.stages.extraction import ExtractionStage, SearchOptions
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.correctness import error_over_bound

START_NS, STEP_NS = stamp_from_epoch_year(2026.5), 100_000_000


def turning(rate_deg_s):
    return motion_from_options(MotionOptions(
        motion='constant_rate', ra_deg=200.0, dec_deg=25.0, rate_deg_s=rate_deg_s))


def run(frames, rate_deg_s, detector=DetectorOptions(), artefacts=ArtefactOptions(),
        change=lambda index, image: image):
    """Yield pipeline, frame of the pipeline and frame of the simulator."""
    sky = SkySimulator(CAMERA, turning(rate_deg_s), load_catalog(), 2026.5,
                       detector_options=detector, artefact_options=artefacts, frame_rate_hz=10.0)
    pipeline = StarTracker(CAMERA, 2026.5)
    for index in range(frames):
        frame = sky.frame(1 + index / 10)
        image = change(index, frame.image)
        pipeline.motion.add_state(START_NS + index * STEP_NS, frame.state.geocentric)
        yield pipeline, pipeline.process(START_NS + index * STEP_NS, image), frame


def over_bound(result, frame):
    attitude = result.attitude
    return error_over_bound(attitude.quaternion, attitude.covariance_sensor,
                            frame.state.q_icrf_from_sensor)


def test_one_image_a_second_is_searched_while_tracking():
    windowed = [pipeline.extraction.windowed for pipeline, *_ in run(25, (0.1, 0.0, 0.0))]
    assert not any(windowed[:3]) and 16 <= sum(windowed) <= 22
    assert not all(windowed[5:])


def test_live_options_hold_from_the_next_image_on_and_nothing_is_forgotten():
    for index, (pipeline, result, _) in enumerate(run(9, (0.1, 0.0, 0.0))):
        count = len(result.centroids)
        if index == 6:
            assert pipeline.extraction.windowed and count > 8
            pipeline.extraction.set_options(ExtractionOptions(max_stars=8, method='grey'),
                                            SearchOptions())
    assert pipeline.extraction.windowed and count == 8
    with pytest.raises(NativeError, match='extraction.line_time_us = 9 .* only st_create takes'):
        pipeline.extraction.set_options(ExtractionOptions(line_time_us=9.0), SearchOptions())


@pytest.mark.slow
def test_stars_among_brighter_spots_are_acquired():
    """Most of the 40 brightest spots are false: only more of them hold enough stars."""
    spots = ArtefactOptions(star_like_spots=150)
    results = [(result, frame) for _, result, frame in run(10, (0.1, 0.0, 0.0), artefacts=spots)]
    assert results[-1][0].attitude is not None
    assert all(over_bound(result, frame) < 1 for result, frame in results
               if result.attitude is not None)


def test_more_stars_are_extracted_the_longer_none_is_predicted():
    sky = SkySimulator(CAMERA, turning((0.1, 0.0, 0.0)), load_catalog(), 2026.5,
                       artefact_options=ArtefactOptions(star_like_spots=200), frame_rate_hz=10.0)
    images = [sky.frame(index / 10).image for index in range(7)]

    def counts(**search):
        stage = ExtractionStage(ExtractionOptions(max_stars=30), SearchOptions(**search))
        return [len(stage.process(START_NS + index * STEP_NS, image).centroids)
                for index, image in enumerate(images)]
    assert counts(max_stars_lost=100) == [30, 30, 60, 60, 100, 100, 100]
    assert counts(max_stars_lost=10) == [30] * 7


def test_smeared_stars_are_tracked_at_three_degrees_a_second():
    detector = DetectorOptions(motion_smear=True)
    published, windowed = 0, 0
    for pipeline, result, frame in run(20, (2.5, 1.5, 0.3), detector):
        windowed += pipeline.extraction.windowed
        if result.attitude is not None:
            published += 1
            assert over_bound(result, frame) < 1
    assert published >= 16 and windowed >= 10


def test_a_repeated_image_is_not_an_attitude_while_the_stars_move():
    last = {}

    def repeat(index, image):
        last['image'] = last['image'] if index in (10, 11) else image
        return last['image']

    results = [(result, frame) for _, result, frame in run(16, (0.5, 0.0, 0.0), change=repeat)]
    assert all(results[k][0].attitude is None for k in (10, 11))
    assert results[9][0].attitude is not None
    assert over_bound(*results[15]) < 1


def test_a_frozen_camera_gives_no_attitude_however_slowly_the_stars_move():
    last = {}

    def freeze(index, image):
        last['image'] = last['image'] if 10 <= index < 66 else image
        return last['image']

    results = [(result, frame) for _, result, frame in run(70, (0.001, 0.0, 0.0), change=freeze)]
    # Not after the track is lost either, when any image is searched as a whole.
    assert all(result.attitude is None and 'image is that of the frame before' in result.reason
               for result, _ in results[10:66])
    assert results[65][0].state is TrackerState.LOST
    assert over_bound(*results[9]) < 1 and over_bound(*results[69]) < 1


def test_one_image_that_is_shown_again_and_again_has_an_attitude():
    first = {}
    *_, (_, result, _) = run(6, (0.0, 0.0, 0.0), change=lambda index, image: first.setdefault(
        'image', image))
    assert result.attitude is not None


def test_a_readout_longer_than_the_frame_interval_is_named():
    stage = ExtractionStage(ExtractionOptions(line_time_us=250.0))
    image = np.random.default_rng(1).normal(100, 3, (512, 512)).astype(np.uint16)
    assert stage.process(START_NS, image).status != 'readout'
    found = stage.process(START_NS + STEP_NS, image[::-1])
    assert found.status == 'readout' and 'line_time_us' in found.reason
    assert stage.process(START_NS + 3 * STEP_NS, image).status != 'readout'


def test_streaks_across_the_motion_of_the_stars_are_not_used():
    """The camera turns about one axis, its images show the streaks of a turn about another."""
    other = SkySimulator(CAMERA, turning((0.0, 2.5, 0.0)), load_catalog(), 2026.5,
                         detector_options=DetectorOptions(motion_smear=True), frame_rate_hz=10.0)
    *_, (pipeline, _, _) = run(5, (1.0, 0.0, 0.0))
    predicted = pipeline.tracker.predicted
    found = ExtractionStage().process(predicted.stamp_ns + STEP_NS, other.frame(1.0).image,
                                      predicted)
    assert found.status == 'streak' and 'another direction' in found.reason


@pytest.mark.parametrize('row', [30, 256, 480])
@pytest.mark.parametrize('noise_dn', [0.0, 1.5])
def test_torn_frames_are_not_published(row, noise_dn):
    """The old rows have their noise of before, or as in a faulty driver noise of their own."""
    rng, before = np.random.default_rng(1), {}

    def tear(index, image):
        torn = image.copy()
        if index >= 6 and index % 2:
            old = before['image'] + rng.normal(0, noise_dn, image.shape)
            torn[row:] = np.rint(old).clip(0).astype(image.dtype)[row:]
        before['image'] = image
        return torn

    results = [(result, frame) for _, result, frame in run(26, (0.6, 0.8, 0.0), change=tear)]
    published = [index for index, (result, _) in enumerate(results)
                 if result.attitude is not None]
    assert max(over_bound(*results[index]) for index in published) < 1
    assert sum(index % 2 == 0 for index in published) >= 8


@pytest.mark.parametrize('artefacts', [
    ArtefactOptions(trails=20), ArtefactOptions(saturated_columns=5, saturated_rows=5)])
def test_trails_and_columns_from_the_first_image_on_do_not_blind_it(artefacts):
    results = [(result, frame) for _, result, frame in run(
        14, (0.1, 0.1, 0.0), artefacts=artefacts)]
    published = [pair for pair in results if pair[0].attitude is not None]
    assert len(published) >= 10 and max(over_bound(*pair) for pair in published) < 1


def test_ten_thousand_hits_do_not_end_tracking():
    area_cm2 = (512 * 5.5e-4) ** 2
    storm = SkySimulator(CAMERA, turning((0.1, 0.1, 0.0)), load_catalog(), 2026.5,
                         detector_options=DetectorOptions(
                             cosmic_ray_hits_cm2_s=2500 / area_cm2 / 0.1), frame_rate_hz=10.0)

    def damage(index, image):
        return storm.frame(1 + index / 10).image if index >= 6 else image

    results = [(result, frame) for _, result, frame in run(20, (0.1, 0.1, 0.0), change=damage)]
    published = [pair for pair in results if pair[0].attitude is not None]
    assert len(published) >= 17 and max(over_bound(*pair) for pair in published) < 1


def test_hits_and_their_tracks_do_not_change_the_width_of_the_stars():
    area_cm2 = (512 * 5.5e-4) ** 2
    clear, storm = (SkySimulator(
        CAMERA, turning((0.1, 0.1, 0.0)), load_catalog(), 2026.5, frame_rate_hz=10.0,
        detector_options=DetectorOptions(cosmic_ray_hits_cm2_s=hits / area_cm2 / 0.1), seed=1)
        for hits in (0, 400))
    extractor = CentroidExtractor(ExtractionOptions())
    found, searched = extractor.search(clear.frame(1.0).image)
    width_px = found.psf_sigma_px
    for index in range(10):
        found, searched = extractor.search(storm.frame(1.1 + index / 10).image, before=searched)
        assert found.psf_sigma_px == pytest.approx(width_px, rel=0.2)


def test_three_hundred_false_spots_do_not_end_tracking():
    rng = np.random.default_rng(4)

    def spot(index, image):
        light = image.astype(float)
        if index >= 8:
            for u, v in rng.integers(4, 507, (80, 2)):
                light[v - 1:v + 2, u - 1:u + 2] += np.outer([0.5, 1, 0.5], [0.5, 1, 0.5]) * (
                    rng.uniform(30, 800))
        return np.minimum(light, 4095).astype(np.uint16)

    results = [(result, frame) for _, result, frame in run(25, (0.1, 0.1, 0.0), change=spot)]
    published = [pair for pair in results[8:] if pair[0].attitude is not None]
    assert len(published) >= 16 and max(over_bound(*pair) for pair in published) < 1


DEBRIS = ArtefactOptions(debris=60, debris_sigma_px=2.5)


def test_debris_out_of_focus_that_enters_does_not_end_tracking():
    """In the one image a second that is searched as a whole, bright particles fill the list."""
    drifting = SkySimulator(CAMERA, turning((0.1, 0.1, 0.0)), load_catalog(), 2026.5,
                            artefact_options=DEBRIS, frame_rate_hz=10.0)

    def enter(index, image):
        return drifting.frame(1 + index / 10).image if index >= 6 else image

    results = [(result, frame) for _, result, frame in run(26, (0.1, 0.1, 0.0), change=enter)]
    published = [pair for pair in results[6:] if pair[0].attitude is not None]
    assert len(published) >= 19 and max(over_bound(*pair) for pair in published) < 1


def test_stars_among_debris_out_of_focus_are_acquired_within_two_seconds():
    results = [(result, frame) for _, result, frame in run(20, (0.1, 0.1, 0.0), artefacts=DEBRIS)]
    published = [pair for pair in results if pair[0].attitude is not None]
    assert len(published) >= 12 and max(over_bound(*pair) for pair in published) < 1


def exposure(given_s, *shown):
    """Return exposure and its limits in s after images that show one, with a weight each."""
    return filled('stt_exposure', (3,), given_s, np.array(shown, float), len(shown))


def test_an_exposure_is_the_mean_of_what_images_show_and_follows_a_change():
    rng = np.random.default_rng(1)
    shown = [(0.05 * (1 + 0.05 * rng.standard_normal()), 30.0) for _ in range(20)]
    seconds, low, high = exposure(0.0, *shown)
    assert seconds == pytest.approx(0.05, rel=0.04)
    assert low < 0.05 < high and (high - low) / 0.1 < 0.05
    shown.append((0.02, 1.0))
    assert exposure(0.0, *shown)[0] == pytest.approx(0.05, rel=0.04)
    assert exposure(0.0, *shown, (0.02, 30.0))[0] == 0.02


def test_a_given_exposure_is_not_estimated():
    assert exposure(0.1, (0.02, 1e6)).tolist() == [0.1, 0.1, 0.1]
    image = next(run(1, (1.0, 0.0, 0.0)))[2].image
    stage = ExtractionStage(ExtractionOptions(exposure_s=0.03))
    assert stage.process(START_NS, image).centroids.exposure_s == (0.03, 0.03)
    found = stage.process(START_NS + STEP_NS, image + 1, exposure_s=0.05)
    assert found.centroids.exposure_s == (0.03, 0.03)


def test_an_exposure_that_changes_from_image_to_image_is_that_of_its_streaks():
    """Estimated from the images alone it is wrong in every other one."""
    exposures_s = 0.03, 0.09
    skies = [SkySimulator(
        CAMERA, turning((2.5, 1.5, 0.3)), load_catalog(), 2026.5, frame_rate_hz=10.0,
        detector_options=DetectorOptions(motion_smear=True, exposure_s=exposure_s))
        for exposure_s in exposures_s]
    tracker = StarTracker(CAMERA, 2026.5)
    stage, streaks_px = tracker.extraction, ([], [])
    published = windowed = 0
    for index in range(20):
        frame, stamp_ns = skies[index % 2].frame(1 + index / 10), START_NS + index * STEP_NS
        tracker.motion.add_state(stamp_ns, frame.state.geocentric)
        found = stage.process(stamp_ns, frame.image, tracker.tracker.predicted,
                              exposure_s=exposures_s[index % 2])
        assert found.centroids.exposure_s == (exposures_s[index % 2],) * 2
        windowed += stage.windowed
        result = tracker.process_centroids(stamp_ns, found.centroids, stage.windowed)
        if result.attitude is not None:
            published += 1
            assert over_bound(result, frame) < 1
            streaks_px[index % 2].append(found.streak_px)
    assert published >= 17 and windowed >= 12, (published, windowed)
    assert max(streaks_px[0]) < 0.5 * min(streaks_px[1]), streaks_px
    # What was given last holds for images of which nothing is said.
    found = stage.process(START_NS + 20 * STEP_NS, skies[0].frame(3.0).image)
    assert found.centroids.exposure_s == (0.09, 0.09)

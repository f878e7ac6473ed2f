# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames as a whole: torn, repeated, stamped wrongly, exposed upwards; presets."""

from dataclasses import replace

import numpy as np
import pytest
from skies import SMALL_CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.from_options import PRESETS, with_preset
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator

CAMERA = Camera.from_fov(128, 128, 8.0)
CATALOG = load_catalog().brighter_than(6.5)
RATE_HZ = 30.0


def simulator(artefacts=ArtefactOptions(), detector=DetectorOptions(), seed=5, camera=CAMERA):
    motion = motion_from_options(MotionOptions(
        motion='constant_rate', rate_deg_s=(2.0, 3.0, 1.0)))
    return SkySimulator(camera, motion, CATALOG, 2026.5, detector_options=detector,
                        artefact_options=artefacts, frame_rate_hz=RATE_HZ, seed=seed)


def time_of(index):
    """Return the time of an image as the node has it: to the nanosecond."""
    return round(index / RATE_HZ * 1e9) / 1e9


@pytest.fixture(scope='module')
def plain():
    plain = simulator()
    return [plain.frame(time_of(index)) for index in range(60)]


def test_a_torn_frame_is_this_one_above_and_the_one_before_below(plain):
    damaged = simulator(ArtefactOptions(torn_frame_probability=0.3))
    frames = [damaged.frame(time_of(index)) for index in range(60)]
    torn = [index for index, frame in enumerate(frames) if frame.artefacts.torn_row]
    assert 8 <= len(torn) <= 28 and 0 not in torn
    for index in torn:
        frame, row = frames[index], frames[index].artefacts.torn_row
        np.testing.assert_array_equal(frame.image[:row], plain[index].image[:row])
        np.testing.assert_array_equal(frame.image[row:], frames[index - 1].image[row:])
        assert (frame.image[row:] != plain[index].image[row:]).any()
        np.testing.assert_array_equal(frame.state.q_icrf_from_sensor,
                                      plain[index].state.q_icrf_from_sensor)
        for uv in frame.stars.uv:
            source = plain[index] if uv[1] < row - 0.5 else frames[index - 1]
            assert (source.stars.uv == uv).all(-1).any()
        assert len(frame.stars) == len(frame.flux_dn)
    for index in set(range(60)) - set(torn):
        np.testing.assert_array_equal(frames[index].image, plain[index].image)


def test_a_repeated_frame_is_the_one_before_under_another_stamp(plain):
    damaged = simulator(ArtefactOptions(repeated_frame_probability=0.3))
    frames = [damaged.frame(time_of(index)) for index in range(60)]
    repeated = [index for index, frame in enumerate(frames) if frame.artefacts.repeated]
    assert 8 <= len(repeated) <= 28
    for index in repeated:
        np.testing.assert_array_equal(frames[index].image, frames[index - 1].image)
        np.testing.assert_array_equal(frames[index].stars.uv, frames[index - 1].stars.uv)
        np.testing.assert_array_equal(frames[index].state.q_icrf_from_sensor,
                                      plain[index].state.q_icrf_from_sensor)


def test_artefacts_depend_on_seed_and_time_alone():
    options = with_preset(ArtefactOptions(torn_frame_probability=0.4, trails=2), 'harsh')
    detector = with_preset(DetectorOptions(), 'harsh')
    first, second = (simulator(options, detector) for _ in range(2))
    straight = [first.frame(time_of(index)) for index in range(6)]
    for index in (5, 2, 0):
        again = second.frame(time_of(index))
        np.testing.assert_array_equal(again.image, straight[index].image)
        assert again.artefacts.counts() == straight[index].artefacts.counts()
    assert (straight[1].artefacts.trails != straight[0].artefacts.trails).all()


def test_false_light_leaves_the_noise_of_the_rest_as_it_is(plain):
    """Artefacts have random numbers of their own."""
    frame = simulator(ArtefactOptions(trails=1, star_like_spots=3)).frame(time_of(1))
    same = frame.image == plain[1].image
    assert 0.85 < same.mean() < 1
    assert frame.artefacts.spots == np.count_nonzero(frame.stars.hip == 0) == 3


@pytest.mark.parametrize('stamp, sign', [('start', -1), ('end', 1)])
def test_a_wrong_stamp_is_half_an_exposure_off(stamp, sign):
    detector = DetectorOptions(noise=False, exposure_s=0.06)
    frame = simulator(ArtefactOptions(stamp=stamp), detector).frame(1.0)
    assert frame.artefacts.stamp_offset_s == pytest.approx(sign * 0.03)
    exposed = simulator(detector=detector).frame(1.0 - sign * 0.03)
    np.testing.assert_array_equal(frame.image, exposed.image)
    np.testing.assert_array_equal(frame.stars.uv, exposed.stars.uv)
    right = simulator(detector=detector).frame(1.0)
    np.testing.assert_array_equal(frame.state.q_icrf_from_sensor, right.state.q_icrf_from_sensor)
    assert (frame.image != right.image).any()


def test_the_first_frame_may_be_exposed_before_its_stamp():
    simulator(ArtefactOptions(stamp='end')).frame(0.0)


def test_reading_upwards_is_reading_downwards_with_the_motion_reversed():
    """Row v is exposed (v - middle) lines later downwards, and as many earlier upwards."""
    def frame_of(direction, rate_deg_s):
        motion = motion_from_options(MotionOptions(motion='constant_rate', rate_deg_s=rate_deg_s))
        options = DetectorOptions(noise=False, line_time_us=200.0, readout_direction=direction)
        return SkySimulator(CAMERA, motion, CATALOG, 2026.5, detector_options=options).frame(0.0)
    up = frame_of('up', (1.0, 4.0, 2.0))
    mirrored = frame_of('down', (-1.0, -4.0, -2.0))
    down = frame_of('down', (1.0, 4.0, 2.0))
    both = np.isin(up.stars.hip, mirrored.stars.hip)
    assert both.sum() >= 5
    for hip, uv in zip(up.stars.hip[both], up.stars.uv[both]):
        assert np.abs(mirrored.stars.uv[mirrored.stars.hip == hip][0] - uv).max() < 1e-3
    still = frame_of('down', (0.0, 0.0, 0.0))
    moved = []
    for hip, uv in zip(still.stars.hip, still.stars.uv):
        if hip in up.stars.hip and hip in down.stars.hip:
            one = up.stars.uv[up.stars.hip == hip][0] - uv
            other = down.stars.uv[down.stars.hip == hip][0] - uv
            assert np.abs(one + other).max() < 0.1 * max(np.abs(one).max(), 0.1)
            moved.append(np.abs(one).max())
    assert max(moved) > 0.5


def test_everything_off_is_the_plain_image(plain):
    explicit = simulator(ArtefactOptions(**{row.name: row.default
                                            for row in ArtefactOptions.table()}))
    np.testing.assert_array_equal(explicit.frame(time_of(3)).image, plain[3].image)
    assert not any(plain[3].artefacts.counts().values())


def test_a_preset_leaves_what_the_user_has_set():
    options = DetectorOptions(flat_field_percent=3.0)
    assert with_preset(options, 'none') == options
    harsh = with_preset(options, 'harsh')
    assert harsh.flat_field_percent == 3.0
    assert harsh.blooming and harsh.row_noise_dn == PRESETS['harsh']['row_noise_dn']
    known = {row.name: row for cls in (DetectorOptions, ArtefactOptions) for row in cls.table()}
    for name, value in PRESETS['harsh'].items():
        assert known[name].check(value) != known[name].default


def test_a_harsh_frame_has_what_the_truth_says():
    frame = simulator(with_preset(ArtefactOptions(), 'harsh'),
                      with_preset(DetectorOptions(), 'harsh'), camera=SMALL_CAMERA).frame(0.0)
    counts = frame.artefacts.counts()
    assert counts['trails'] == 1 and counts['saturated_columns'] == 1
    assert counts['dead_columns'] == 2 and counts['warm_columns'] == 4
    [column] = frame.artefacts.defects.saturated_columns
    assert (frame.image[:, column] > 3500).mean() > 0.99
    dead = frame.image[:, frame.artefacts.defects.dead_columns]
    assert np.abs(dead.astype(float) - 64).max() < 40
    assert replace(frame.artefacts, repeated=True).counts()['repeated'] == 1

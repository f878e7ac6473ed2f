# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A lens that changes in flight: found within its sigma, proposed after proof, never by chance."""

from dataclasses import replace

import numpy as np
import pytest
from skies import onboard_stars, synthetic_field
from startracker_ros.core.calibration.adjustment import CalibrationError
from startracker_ros.core.calibration.lens_filter import LensFilter, LensFrame
from startracker_ros.core.calibration.online import OnlineCalibration, OnlineOptions
from startracker_ros.core.calibration.tracked_frames import tracked_frame
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.maths.rotation import (
    multiply, quaternion_from_rotation_vector, random_attitude, rotate)
from startracker_ros.core.track.tracks import Tracks
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

CAMERA = Camera.from_fov(1024, 1024, 20.0)
WIDE = Camera.from_fov(1024, 1024, 50.0)
SIGMA_PX = 0.1
STEP_NS = 10 * 10 ** 9


def frame_of(truth, rng, index=0, temperature_c=np.nan, stars=20):
    """Return a frame of random stars in the true camera, with an attitude 2 px off."""
    uv = rng.uniform(10, truth.width - 10, (stars, 2))
    q = random_attitude(rng)
    icrf = rotate(q, truth.unproject(uv))
    q = multiply(q, quaternion_from_rotation_vector(rng.normal(0, truth.pixel_rad, 3)))
    return LensFrame(index * STEP_NS, uv + rng.normal(0, SIGMA_PX, uv.shape),
                     np.full(stars, SIGMA_PX), icrf, q, temperature_c)


def fly(camera, truth_at, frames, seed, temperature_at=lambda index: np.nan):
    """Feed frames, each proposal applied; return the calibration and (index, proposal) of all."""
    calibration, rng, found = OnlineCalibration(camera), np.random.default_rng(seed), []
    for index in range(frames):
        proposal = calibration.add(frame_of(truth_at(index), rng, index, temperature_at(index)))
        if proposal is not None:
            calibration.use(proposal.camera)
            found.append((index, proposal))
    return calibration, found


def test_a_focal_length_that_drifts_with_the_temperature_is_found():
    def temperature_at(index):
        return 20 + 10 * np.sin(index / 19)

    def truth_at(index):
        # 1e-4 over 10 K.
        return CAMERA.with_focal_ratio(1 + 1e-5 * (temperature_at(index) - 20))
    calibration, found = fly(CAMERA, truth_at, 120, 1, temperature_at)
    last_c = temperature_at(119)
    slope, sigma = calibration.filter.figures(last_c)['focal_ppm_k']
    assert abs(slope - 10) < 3 * sigma and sigma < 2
    focal, sigma = calibration.filter.figures(last_c)['focal']
    assert abs(focal - truth_at(119).fx) < 3 * sigma < 2e-4 * focal
    assert found
    for index, proposal in found:
        assert proposal.changes == ('focal',)
        # Better than the camera before, at the temperature of the proposal.
        assert proposal.chi_square_after < proposal.chi_square_before
        assert abs(proposal.camera.fx / truth_at(index).fx - 1) < 5e-5
        assert (proposal.camera.cx, proposal.camera.distortion) == (CAMERA.cx, CAMERA.distortion)


def test_a_wrong_principal_point_is_found():
    truth = replace(WIDE, cx=WIDE.cx + 0.5)
    calibration, found = fly(WIDE, lambda index: truth, 80, 2)
    value, sigma = calibration.filter.figures(np.nan)['cx']
    assert abs(value - truth.cx) < 3 * sigma < 0.3
    assert [proposal.changes for _, proposal in found] == [('centre',)]
    assert abs(found[0][1].camera.cx - truth.cx) < 0.2
    assert 'centre changed by up to 0.1' in str(found[0][1])


@pytest.mark.parametrize('seed', range(5))
def test_a_correct_camera_is_left_alone(seed):
    calibration, found = fly(CAMERA, lambda index: CAMERA, 80, seed)
    assert not found
    lens, covariance = calibration.filter.at(np.nan)
    assert lens @ np.linalg.solve(covariance, lens) < 20


def test_the_estimate_is_consistent():
    truth = replace(WIDE, cx=WIDE.cx - 0.4, distortion=(2e-3, 0, 0, 0, 0)).with_focal_ratio(1.0003)
    nees = []
    for seed in range(6):
        lens_filter, rng = LensFilter(WIDE, 1.0, 0.0), np.random.default_rng(seed)
        for index in range(25):
            lens_filter.update(lens_filter.checked(frame_of(truth, rng, index)))
        lens, covariance = lens_filter.at(np.nan)
        error = lens - lens_filter.lens_of(truth)
        nees.append(error @ np.linalg.solve(covariance, error))
    low, high = mean_chi_square_bounds(4, len(nees))
    assert low < np.mean(nees) < high, (low, np.mean(nees), high)


def test_nothing_is_proposed_that_frames_left_out_do_not_prove():
    calibration, rng = OnlineCalibration(CAMERA), np.random.default_rng(3)
    wrong = CAMERA.with_focal_ratio(1.00016)
    for index in range(60):
        # What is estimated is wrong; the frames left out, every fourth, are of the camera in use.
        truth = CAMERA if index % 4 == 3 else wrong
        assert calibration.add(frame_of(truth, rng, index)) is None
    lens, covariance = calibration.filter.at(np.nan)
    assert lens[0] > 5 * np.sqrt(covariance[0, 0])


def test_stars_at_the_same_pixels_add_nothing():
    calibration, frame = OnlineCalibration(CAMERA), frame_of(CAMERA, np.random.default_rng(4))
    for index in range(20):
        calibration.add(replace(frame, stamp_ns=index * STEP_NS))
    assert calibration.frames == {'used': 1, 'left out': 0, 'pointing already there': 19}


@pytest.mark.parametrize(('change', 'words'), [
    (lambda f: replace(f, uv=f.uv * np.nan), 'NaN or infinity'),
    (lambda f: replace(f, icrf=f.icrf * np.inf), 'NaN or infinity'),
    (lambda f: replace(f, sigma_px=-f.sigma_px), 'not positive and finite'),
    (lambda f: replace(f, uv=f.uv[:5], sigma_px=f.sigma_px[:5], icrf=f.icrf[:5]),
     '5 identified stars in a frame, 8'),
    (lambda f: replace(f, uv=f.uv + 1000), 'outside of the 1024 x 1024 px'),
    (lambda f: replace(f, uv=1023 - f.uv[:, ::-1]), 'another camera'),
    (lambda f: replace(f, uv=f.uv * [-1, 1] + [1023, 0]), 'another camera'),
    (lambda f: replace(f, uv=(f.uv - 511.5) * 0.98 + 511.5), 'another camera'),
    (lambda f: replace(f, icrf=np.roll(f.icrf, 1, axis=0)), 'another camera')])
def test_stars_of_another_camera_are_rejected_by_name(change, words):
    calibration, rng = OnlineCalibration(CAMERA), np.random.default_rng(5)
    calibration.add(frame_of(CAMERA, rng))
    before = calibration.filter.mean
    with pytest.raises(CalibrationError, match=words):
        calibration.add(change(frame_of(CAMERA, rng, 1)))
    np.testing.assert_array_equal(calibration.filter.mean, before)


def test_centroids_worse_than_their_sigma_count_less():
    rng, lens_filters = np.random.default_rng(7), [LensFilter(CAMERA, 1.0, 0.0) for _ in range(2)]
    for index in range(20):
        frame = frame_of(CAMERA, rng, index)
        for sigma_px, lens_filter in zip((SIGMA_PX, SIGMA_PX / 3), lens_filters):
            lens_filter.update(lens_filter.checked(
                replace(frame, sigma_px=np.full(len(frame.uv), sigma_px))))
    assert 2.2 < np.sqrt(lens_filters[1].variance) < 3.8
    sigma, same = (np.sqrt(np.diag(one.at(np.nan)[1])) for one in lens_filters)
    np.testing.assert_allclose(same, sigma, rtol=0.35)


def test_a_wrong_star_is_left_out():
    lens_filter, rng = LensFilter(CAMERA, 1.0, 0.0), np.random.default_rng(6)
    frame = frame_of(CAMERA, rng)
    frame.uv[3] += 4.0
    assert len(lens_filter.checked(frame).uv) == 19


def test_an_impossible_camera_is_not_a_proposal():
    options = OnlineOptions(lens_sigma_px=100.0)
    calibration = OnlineCalibration(CAMERA, options)
    calibration.filter.mean[:] = [0, 1e6, 0, 0, 0]
    calibration.filter.covariance *= 1e-12
    for index in range(8):
        calibration._left_out.append(frame_of(CAMERA, np.random.default_rng(index)))
    assert calibration._proposal(np.nan) is None


def test_the_centroids_of_tracks_are_measurements():
    onboard = onboard_stars(CAMERA, 2026.7, 6.0)
    centroids, hip = synthetic_field(onboard, CAMERA)
    count, none = len(hip), np.zeros(len(hip))
    rate, delay_s = np.tile([100.0, -50.0], (count, 1)), np.linspace(0, 0.02, count)
    moved = replace(centroids, uv=centroids.uv + rate * delay_s[:, None], delay_s=delay_s)
    tracks = replace(
        Tracks.empty(), hip=hip, uv=centroids.uv + 0.5, velocity=rate,
        missed=np.zeros(count, np.uint8), magnitude=none)
    frame = tracked_frame(CAMERA, onboard, 7, moved, tracks)
    crowded = onboard.crowded[onboard.index_of(hip)]
    assert len(frame.uv) == np.count_nonzero(~crowded) > 20
    # Not the pixels of the tracks, which the camera in use has made.
    distance = np.linalg.norm(frame.uv[:, None] - centroids.uv, axis=2).min(axis=1)
    assert distance.max() < 1e-9
    sensor = rotate(frame.quaternion * [-1, -1, -1, 1], frame.icrf)
    np.testing.assert_allclose(CAMERA.project(sensor), frame.uv, atol=1e-5)
    lost = replace(tracks, missed=np.ones(count, np.uint8))
    with pytest.raises(CalibrationError, match='0 identified stars'):
        tracked_frame(CAMERA, onboard, 7, moved, lost)
    with pytest.raises(CalibrationError, match='0 identified stars'):
        tracked_frame(CAMERA, onboard, 7, Centroids.empty(), tracks)

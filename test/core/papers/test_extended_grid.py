# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two and three stars of a narrow field by a predicted attitude: right, or no result."""

from functools import partial

import numpy as np
import pytest
import skies
from skies import NARROW_CAMERA as CAMERA, onboard_stars
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_rotation_vector, random_attitude)
from startracker_ros.core.papers.extended_grid import (
    AttitudePrediction, ExtendedGridIdentifier, PredictedField, RecursiveIdentifier)
from startracker_ros.core.papers.prior_verification import PriorVerifier
from startracker_ros.sim.sky.sensors import Gyro, GyroOptions

EPOCH_YEAR = 2026.5
OPTIONS = IdentificationOptions(method='extended_grid', magnitude_limit=8.0)
S = 1_000_000_000


@pytest.fixture(scope='module')
def onboard():
    return onboard_stars(CAMERA, EPOCH_YEAR, 7.5)


@pytest.fixture(scope='module')
def identifier():
    return make_identifier(CAMERA, EPOCH_YEAR, OPTIONS)


def prior_near(q, sigma_deg, rng, off_deg=None):
    """Return a prediction wrong by its own sigma, or by off_deg about any axis."""
    error = rng.normal(0, np.radians(sigma_deg), 3)
    if off_deg is not None:
        error *= np.radians(off_deg) / np.linalg.norm(error)
    return AttitudePrediction(multiply(q, quaternion_from_rotation_vector(error)),
                              np.eye(3) * np.radians(sigma_deg) ** 2)


frame = partial(skies.frame, sigma_px=0.3)


def check_right(result, hip, q):
    """Every named star is right, and the attitude keeps to its own covariance."""
    named = result.hip > 0
    np.testing.assert_array_equal(result.hip[named], hip[named])
    error = attitude_error(result.attitude.quaternion, q)
    assert error @ np.linalg.solve(result.attitude.covariance_sensor, error) < 30


@pytest.mark.parametrize('count, sigma_deg, least', [
    (2, 0.001, 0.9), (3, 0.003, 0.95), (20, 0.03, 0.97)])
def test_as_few_as_two_stars(identifier, onboard, count, sigma_deg, least):
    rng = np.random.default_rng(count)
    solved = 0
    for _ in range(80):
        q = random_attitude(rng)
        centroids, hip = star_list(onboard, CAMERA, q, 0.3, rng)
        centroids, hip = centroids.select(slice(count)), hip[:count]
        result = identifier.identify(centroids, prior_near(q, sigma_deg, rng))
        if result.status == 'identified':
            check_right(result, hip, q)
            assert result.matched >= 2 and result.false_alarm_probability <= 1e-5
            solved += 1
        else:
            assert result.attitude is None and not result.hip.any() and result.reason
    assert solved >= least * 80


def test_an_unsure_prediction_is_not_enough_for_two_stars(identifier, onboard):
    """The same stars and a prediction of three minutes of arc: that may be chance."""
    rng = np.random.default_rng(1)
    q = random_attitude(rng)
    centroids = star_list(onboard, CAMERA, q, 0.3, rng)[0].select(slice(2))
    sure, unsure = (identifier.identify(centroids, prior_near(q, sigma_deg, rng))
                    for sigma_deg in (0.001, 0.05))
    assert sure.status == 'identified'
    assert unsure.status == 'no_candidate' and 'chance' in unsure.reason
    assert unsure.false_alarm_probability > 1e-5


@pytest.mark.parametrize('off_deg', [0.5, 2.0, 40.0])
def test_a_wrong_prediction_is_not_accepted(identifier, onboard, off_deg):
    rng = np.random.default_rng(4)
    for _ in range(40):
        q = random_attitude(rng)
        centroids, hip = star_list(onboard, CAMERA, q, 0.3, rng)
        result = identifier.identify(centroids, prior_near(q, 0.003, rng, off_deg))
        # A turn about the boresight may leave stars near the centre where they are predicted.
        if result.attitude is not None:
            check_right(result, hip, q)
            assert off_deg < 1
        else:
            assert not result.hip.any()


@pytest.mark.parametrize('count', [2, 4, 15])
def test_false_stars_alone_are_not_accepted(identifier, count):
    rng = np.random.default_rng(count)
    for _ in range(60):
        uv = rng.uniform(0, 1023, (count, 2))
        result = identifier.identify(frame(uv), prior_near(random_attitude(rng), 0.03, rng))
        assert result.attitude is None and not result.hip.any()


def test_missing_and_false_stars(identifier, onboard):
    rng = np.random.default_rng(6)
    solved = 0
    for _ in range(60):
        q = random_attitude(rng)
        centroids, hip = star_list(onboard, CAMERA, q, 0.3, rng, missing=0.2, false=3,
                                   brightest_false=4.0)
        result = identifier.identify(centroids, prior_near(q, 0.003, rng))
        if result.attitude is not None:
            solved += 1
            check_right(result, hip, q)
    assert solved >= 50


def test_chance_is_what_it_says():
    """Stars at random, each taken for the predicted star that is next to it."""
    rng = np.random.default_rng(7)
    half = np.tan(np.radians(2.0))
    area = CAMERA.width * CAMERA.height * CAMERA.pixel_rad ** 2
    covariance = np.diag([*[np.radians(0.03) ** 2] * 3, 0.0])
    chances = []
    for _ in range(3000):
        predicted, seen = rng.uniform(-half, half, (15, 2)), rng.uniform(-half, half, (5, 2))
        verifier = PriorVerifier(seen, np.full(5, 5 * CAMERA.pixel_rad), predicted,
                                 np.ones(15, bool), covariance, 3.5, area)
        nearest = np.linalg.norm(seen[:, None] - predicted, axis=2).argmin(1)
        match = verifier.verify(nearest, np.zeros(15, bool), 1e-5)
        chances.append(1.0 if match is None else match.false_alarm)
    for level in (0.05, 0.01):
        assert np.mean(np.array(chances) <= level) <= 1.3 * level
    # Nor is it so high that the bound is useless.
    assert np.mean(np.array(chances) <= 0.05) > 0.0005


def test_a_star_that_may_be_either_of_two_is_left_out():
    """The third place has a neighbour within reach of the noise."""
    pixel = CAMERA.pixel_rad
    predicted = pixel * np.array(
        [[-300.0, 10.0], [200.0, 250.0], [100.0, -300.0], [103.0, -300.0]])
    verifier = PriorVerifier(predicted[:3], np.full(3, pixel), predicted,
                             np.ones(4, bool), np.diag([*[(2 * pixel) ** 2] * 3, 0.0]), 3.5,
                             CAMERA.width * CAMERA.height * pixel ** 2)
    match = verifier.verify(np.array([0, 1, 2]), np.zeros(4, bool), 1e-3)
    np.testing.assert_array_equal(match.row, [0, 1, -1])
    doubtful = verifier.verify(np.array([0, 1, 2]), np.array([True, False, False, False]), 1e-3)
    np.testing.assert_array_equal(doubtful.row, [-1, 1, -1])
    assert doubtful.false_alarm == 1.0


def test_patterns_against_a_slow_oracle(identifier):
    """Complex numbers, one star after the other; a turn and a shift change nothing."""
    rng = np.random.default_rng(8)
    cell = np.radians(0.2)
    place = rng.uniform(-0.07, 0.07, (40, 2))
    points = place @ [1, 1j]
    cells, neighbour = identifier.patterns(place, np.arange(10))
    for star in range(10):
        away = points - points[star]
        next_one = min((k for k in range(40) if abs(away[k]) > np.radians(0.3)),
                       key=lambda k: abs(away[k]))
        assert neighbour[star] == next_one
        turned = away / (away[next_one] / abs(away[next_one])) / cell + 20.5 * (1 + 1j)
        occupied = {(int(z.imag // 1), int(z.real // 1)) for z in turned
                    if 0 <= z.real < 40 and 0 <= z.imag < 40}
        assert {divmod(k, 40) for k in np.flatnonzero(cells[star])} == occupied
    moved = points * np.exp(0.7j) + (0.01 - 0.02j)
    again, _ = identifier.patterns(np.column_stack([moved.real, moved.imag]), np.arange(10))
    np.testing.assert_array_equal(again, cells)


@pytest.mark.slow
def test_without_a_usable_prediction_it_is_the_pyramid(identifier, onboard):
    rng = np.random.default_rng(9)
    pyramid = make_identifier(CAMERA, EPOCH_YEAR, IdentificationOptions(magnitude_limit=8.0))
    q = random_attitude(rng)
    centroids, hip = star_list(onboard, CAMERA, q, 0.3, rng)
    unsure = prior_near(q, 0.1, rng)
    assert not identifier.captures(unsure)
    for result in (identifier.identify(centroids), identifier.identify(centroids, unsure)):
        np.testing.assert_array_equal(result.hip, pyramid.identify(centroids).hip)
        check_right(result, hip, q)
    assert identifier.identify(centroids.select(slice(2))).status == 'too_few_stars'


@pytest.mark.parametrize('count', [0, 1])
def test_too_few_stars(identifier, count):
    rng = np.random.default_rng(10)
    result = identifier.identify(frame(rng.uniform(0, 1023, (count, 2))),
                                 prior_near(random_attitude(rng), 0.003, rng))
    assert result.status == 'too_few_stars' and f'{count} usable stars' in result.reason


def test_useless_rows_are_left_out(identifier, onboard):
    """NaN, outside the image, found twice: the rest still gives the right result."""
    rng = np.random.default_rng(11)
    q = random_attitude(rng)
    centroids, hip = star_list(onboard, CAMERA, q, 0.3, rng)
    bad = [[np.nan, 5.0], [-50.0, 10.0], [1e6, 1e6], *(centroids.uv[:2] + 0.2)]
    uv = np.concatenate([centroids.uv, bad])
    result = identifier.identify(frame(uv), prior_near(q, 0.003, rng))
    assert result.status == 'identified' and not result.hip[-5:].any()
    check_right(result, np.concatenate([hip, np.zeros(5, int)]), q)


def test_thousands_of_centroids(identifier):
    rng = np.random.default_rng(12)
    result = identifier.identify(frame(rng.uniform(0, 1023, (5000, 2))),
                                 prior_near(random_attitude(rng), 0.003, rng))
    assert result.attitude is None and len(result.hip) == 5000


def test_a_wide_field_and_an_empty_sky():
    """Nothing is taken for granted: 60 deg of field, a catalogue of one star."""
    rng = np.random.default_rng(13)
    wide = ExtendedGridIdentifier(Camera.from_fov(512, 512, 60.0), EPOCH_YEAR,
                                  IdentificationOptions(method='extended_grid'))
    lonely = make_identifier(CAMERA, EPOCH_YEAR, IdentificationOptions(
        method='extended_grid', magnitude_limit=0.01))
    for identifier in (wide, lonely):
        result = identifier.identify(frame(rng.uniform(0, 511, (5, 2))),
                                     prior_near(random_attitude(rng), 0.003, rng))
        assert result.attitude is None


def test_from_frame_to_frame(identifier, onboard):
    """One full frame, then the two brightest stars alone; the gyro drifts, then falls silent."""
    rng = np.random.default_rng(14)
    recursive = RecursiveIdentifier(identifier, GyroErrorOptions())
    gyro = Gyro(GyroOptions(), rng=rng)
    rate = np.radians([0.03, 0.05, -0.02])
    start = random_attitude(rng)

    def at(second):
        q = multiply(start, quaternion_from_rotation_vector(rate * second))
        return q, *star_list(onboard, CAMERA, q, 0.3, rng)

    q, centroids, hip = at(0)
    assert recursive.identify(0, centroids).status == 'identified'
    assert recursive.condition == 'no imu, lost in space'
    solved = 0
    for second in range(1, 31):
        for k in range(1, 101):
            assert recursive.add_rate((second - 1) * S + k * S // 100, gyro.measure(rate, 0.01))
        q, centroids, hip = at(second)
        result = recursive.identify(second * S, centroids.select(slice(2)))
        assert 'predicted by the gyro' in recursive.condition
        if result.attitude is not None:
            check_right(result, hip[:2], q)
            solved += 1
    assert solved >= 27
    # Half a minute without rates: two stars are too few again, a full frame is not.
    q, centroids, hip = at(60)
    assert recursive.identify(60 * S, centroids.select(slice(2))).attitude is None
    assert recursive.condition == 'no prediction, lost in space'
    result = recursive.identify(61 * S, at(61)[1])
    assert result.status == 'identified'
    assert np.hypot(*attitude_error(result.attitude.quaternion, at(61)[0])[:2]) < 5 * ARCSEC


def test_a_result_that_is_not_accepted_leaves_the_prediction(identifier, onboard):
    rng = np.random.default_rng(15)
    recursive = RecursiveIdentifier(identifier)
    q = random_attitude(rng)
    centroids, hip = star_list(onboard, CAMERA, q, 0.3, rng)
    recursive.identify(0, centroids)
    for second in range(1, 21):
        for k in range(1, 11):
            recursive.add_rate((second - 1) * S + k * S // 10, np.zeros(3))
        false = frame(rng.uniform(0, 1023, (2, 2)))
        if second == 10:
            result = recursive.identify(second * S, centroids.select(slice(3)))
            check_right(result, hip[:3], q)
        else:
            assert recursive.identify(second * S, false).attitude is None


def test_a_turn_that_the_gyro_missed(identifier, onboard):
    """Two stars elsewhere are not accepted, a full field overrules the prediction."""
    rng = np.random.default_rng(16)
    recursive = RecursiveIdentifier(identifier)
    for second in range(2):
        recursive.add_rate(second * S, np.zeros(3))
    q = random_attitude(rng)
    assert recursive.identify(S, star_list(onboard, CAMERA, q, 0.3, rng)[0]).matched > 4
    for k, count in enumerate((2, 20, 2), 1):
        recursive.add_rate(S + k * S // 10, np.zeros(3))
        if k == 1:
            q = random_attitude(rng)
        centroids, hip = star_list(onboard, CAMERA, q, 0.3, rng)
        result = recursive.identify(S + k * S // 10, centroids.select(slice(count)))
        if k == 1:
            assert result.attitude is None and 'predicted' in recursive.condition
        else:
            check_right(result, hip[:count], q)


def occupied_cells(stars, own, cells, cell, buffer):
    """Return the numbers of occupied cells by the words of the paper, star by star."""
    nearest, axis = np.inf, None
    for other, (x, y) in enumerate(stars):
        away = np.hypot(x - stars[own][0], y - stars[own][1])
        if other != own and buffer < away < nearest:
            nearest, axis = away, complex(x - stars[own][0], y - stars[own][1]) / away
    numbers = set()
    for x, y in stars:
        turned = complex(x - stars[own][0], y - stars[own][1]) / axis
        column = int(np.floor(turned.real / cell + cells / 2 + 0.5))
        row = int(np.floor(turned.imag / cell + cells / 2 + 0.5))
        if 0 <= column < cells and 0 <= row < cells:
            numbers.add(row * cells + column)
    return numbers


def test_the_patterns_are_those_of_an_independent_implementation(identifier):
    rng = np.random.default_rng(11)
    for _ in range(20):
        stars = rng.uniform(-0.07, 0.07, (25, 2))
        own = np.arange(10)
        pattern, _ = identifier.patterns(stars, own)
        for row, star in zip(pattern, own):
            assert set(np.flatnonzero(row)) == occupied_cells(
                stars, star, 40, np.radians(0.2), np.radians(0.3))


def test_a_star_next_to_the_limit_does_not_turn_the_grid(identifier):
    """Its neighbour is 0.1 mag fainter than the limit in the catalogue, and in the image."""
    rng = np.random.default_rng(12)
    turn = rng.uniform(0, 2 * np.pi, 12)
    place = rng.uniform(0.012, 0.03, (12, 1)) * np.stack([np.cos(turn), np.sin(turn)], 1)
    place[0], place[11] = 0.0, [0.006, 0.0]
    magnitude = np.linspace(5.0, 7.0, 12)
    magnitude[11] = magnitude[10] + 0.1
    # The image has the faint neighbour and lacks the last star but one.
    seen = np.delete(np.arange(12), 10)
    sky = PredictedField(np.arange(12), place, magnitude, *np.ones((2, 12), bool))
    assert identifier.recognise(place[seen], sky)[0] == 0
    assert identifier.match(place[seen], place[:0], [sky.brightest(len(seen))])[0] != 0

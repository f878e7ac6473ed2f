# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Association, stars in view, starts and models of stars of the native core, as in real runs."""

from collections import defaultdict
from functools import cache
import time

import native_bank
from native_bank import CAMERAS, RECORD, View
import numpy as np
import pytest
from skies import CAMERA, onboard_stars
from startracker_evaluation.campaign.integrity_motion import EPOCH_YEAR, MAGNITUDE_LIMIT
from startracker_ros.core import native
from startracker_ros.core.astro.aberration import Air, apparent_directions, state_near_earth
from startracker_ros.core.astro.bodies import bodies_from_earth
from startracker_ros.core.catalog.onboard import CROWD_MAGNITUDES
from startracker_ros.core.identify.cache import camera_stars, STARS
from startracker_ros.core.maths.rotation import quaternion_from_pointing, rotate
from startracker_ros.core.track.options import ASSOCIATIONS

SUMS = {'rtol': 1e-9, 'atol': 1e-15}
"""Of sums in another order."""
EQUAL = {'rtol': 1e-12, 'atol': 1e-12}
GATE = 18.420680743952367  # of 0.9999
IMAGE_PX2 = 1024.0 ** 2


@cache
def record() -> dict[str, list[dict[str, np.ndarray]]]:
    cases = defaultdict(lambda: defaultdict(dict))
    with np.load(RECORD) as archive:
        for key in archive.files:
            kind, number, name = key.split('/')
            cases[kind][int(number)][name] = archive[key]
    return {kind: [of_kind[number] for number in sorted(of_kind)]
            for kind, of_kind in cases.items()}


@pytest.fixture(scope='module')
def view():
    """Return the sky of the lists of the record, seen by an observer at rest."""
    onboard = camera_stars(CAMERA, EPOCH_YEAR, MAGNITUDE_LIMIT)
    columns = {name: getattr(onboard, name) for name in STARS if name != 'direction'}
    file = native_bank.sky_file(
        CAMERA, onboard.direction, crowd_rad=np.array(onboard.crowd_rad), **columns)
    return View(native_bank.sky_struct(file), CAMERA), onboard, file


# --- association ---


def test_associations_of_real_frames():
    for case in record()['association']:
        probability, unassociated, left_out = native_bank.associate(*(case[name] for name in (
            'predicted', 'covariance', 'uv', 'error', 'detection')))
        np.testing.assert_allclose(probability, case['probability'], rtol=0, atol=1e-12)
        np.testing.assert_array_equal(unassociated, case['unassociated'])
        assert not left_out.any()


def listed(weight):
    """Return the probabilities, and the sum over all joint events, each listed."""
    total, sums = 0.0, np.zeros_like(weight)
    for event in np.ndindex(*(weight.shape[1],) * len(weight)):
        found = [choice for choice in event if choice]
        if len(found) == len(set(found)):
            product = np.prod(weight[range(len(weight)), event])
            sums[range(len(weight)), event] += product
            total += product
    return sums / total, total


@pytest.mark.parametrize('seed', range(20))
def test_probabilities_are_those_of_all_events(seed):
    rng = np.random.default_rng(seed)
    weight = np.exp(rng.normal(0, 4, (rng.integers(1, 5), rng.integers(1, 6))))
    weight[:, 1:] *= rng.random(weight[:, 1:].shape) < 0.7
    probability, log_sum, left_out = native_bank.events(weight)
    expected, total = listed(weight)
    np.testing.assert_allclose(probability, expected, rtol=0, atol=1e-12)
    assert log_sum == pytest.approx(np.log(total), rel=1e-12)
    assert not left_out.any()


def test_a_cluster_beyond_the_limits_is_cut_and_counted():
    weight = np.exp(np.random.default_rng(0).normal(0, 4, (10, 11)))
    exact = native_bank.marginals(weight)
    for steps, most in ((110 * 100, 0.05), (1, 1.0)):
        cut, _, left_out = native_bank.events(weight, steps)
        assert 1e-9 < np.abs(cut - exact).max() < most
        assert left_out[1] > 0
    for shape in ((40, 51), (500, 129)):
        weight = np.exp(np.random.default_rng(1).normal(0, 2, shape))
        begin_s = time.process_time()
        probability, _, left_out = native_bank.events(weight)
        assert time.process_time() - begin_s < 2.0
        assert left_out[1] > 0
        np.testing.assert_allclose(probability.sum(axis=1), 1)
        assert (probability >= 0).all() and (probability[:, 1:].sum(axis=0) <= 1 + 1e-9).all()


@pytest.mark.parametrize('factor', [None, *ASSOCIATIONS])
def test_a_hundred_thousand_false_centroids(factor):
    rng = np.random.default_rng(2)
    detection = GATE, 0.9999, 0.95, IMAGE_PX2
    stars, false = rng.uniform(0, 1024, (40, 2)), rng.uniform(0, 1024, (100_000, 2))
    uv = np.concatenate([stars + rng.normal(0, 0.1, stars.shape), false])
    error = np.full((len(uv), 1, 1), 0.01) * np.eye(2)
    covariance = np.full((40, 1, 1), 0.01) * np.eye(2)
    begin_s = time.process_time()
    probability, unassociated, left_out = native_bank.associate(
        stars, covariance, uv, error, detection, factor)
    assert time.process_time() - begin_s < 2.0
    np.testing.assert_allclose(probability.sum(axis=1), 1)
    assert not left_out.any() and not unassociated[:40].all()
    # Gates that hold thousands: the most probable centroids are kept, the others are counted.
    probability, unassociated, left_out = native_bank.associate(
        stars, 2e4 * covariance, uv, error, detection, factor)
    np.testing.assert_allclose(probability.sum(axis=1), 1)
    inside = ((uv[:, None] - stars) ** 2).sum(axis=2) <= GATE * (2e4 * 0.01 + 0.01)
    assert left_out[0] == np.maximum(inside.sum(axis=0) - 128, 0).sum() > 10_000
    np.testing.assert_array_equal(unassociated, ~inside.any(axis=1))
    nearest = ((uv[:, None] - stars) ** 2).sum(axis=2).argmin(axis=0)
    if factor is None:
        assert (probability[range(40), nearest + 1] > 0).all()


# --- the sky and the stars in view ---


@pytest.mark.parametrize('air', [None, Air(np.array([0.0, 0.6, 0.8]), 2.8e-4, -3e-7)])
def test_apparent_directions(air):
    state = state_near_earth(2026.0, np.array([3e3, 5e3, -4e3]))._replace(air=air)
    natural = np.random.default_rng(1).normal(size=(500, 3))
    # In the direction of the Sun as well.
    natural[0] = -state.heliocentric_au
    natural /= np.linalg.norm(natural, axis=1, keepdims=True)
    np.testing.assert_allclose(
        native_bank.apparent(observer_struct(state), natural),
        apparent_directions(natural, state), rtol=0, atol=1e-15)
    at_rest = np.zeros((), native.OBSERVER)
    np.testing.assert_array_equal(native_bank.apparent(at_rest, natural), natural)


def observer_struct(state=None, bodies=None, max_age_s=np.inf, velocity_sigma_m_s=20.0):
    made = np.zeros((), native.OBSERVER)
    made['max_age_s'], made['velocity_sigma_m_s'] = max_age_s, velocity_sigma_m_s
    made['heliocentric_au'] = np.nan
    if state is not None:
        made['aberration'], made['velocity_m_s'] = 2, state.velocity_m_s
        made['heliocentric_au'] = state.heliocentric_au
        if state.air is not None:
            made['zenith'] = state.air.zenith
            made['refraction_a_rad'], made['refraction_b_rad'] = state.air[1:]
    if bodies is not None:
        body = made['body'][:len(bodies.magnitude)]
        for name in ('direction', 'magnitude', 'radius_rad', 'error_rad'):
            body[name] = getattr(bodies, name)
        made['body_count'] = len(body)
    return made


def test_the_sky_of_a_moving_observer(view):
    _, onboard, file = view
    sky = View(native_bank.sky_struct(file), CAMERA)
    star = np.arange(0, len(onboard), 3)
    states = [state_near_earth(2026.0, np.array(velocity)) for velocity in (
        [3e3, 0.0, 0.0], [3e3 + 1.0, 0.0, 0.0], [3e3 + 2.0, 0.0, 0.0])]
    bodies = bodies_from_earth(2026.0)
    for number, state in enumerate(states):
        sky.add_observer(10 * number, observer_struct(state, bodies))
    versions = [sky.look(stamp_ns)[0] for stamp_ns in (0, 9, 10, 20, 35, 5)]
    # A change of 1 m/s is ignored, that of two is not; a late identification looks back.
    assert np.diff(versions).tolist() == [0, 0, 1, 0, 1]
    direction, crowded = sky.stars(star)
    np.testing.assert_allclose(direction, apparent_directions(
        onboard.direction[star], states[0]), rtol=0, atol=1e-15)
    near = bodies.near(onboard.direction[star], onboard.magnitude[star], onboard.crowd_rad,
                       CROWD_MAGNITUDES).any(axis=1)
    np.testing.assert_array_equal(crowded, onboard.crowded[star] | near)
    moon = np.argmax(onboard.direction[star] @ bodies.direction[7])
    assert near.any() or onboard.direction[star][moon] @ bodies.direction[7] < np.cos(0.02)
    # Too old: the velocity is unknown.
    sky.add_observer(100, observer_struct(states[0], max_age_s=1.0))
    assert sky.look(100)[1][0] == 20.0
    assert sky.look(2 * 10 ** 9)[1][0] == pytest.approx(17800, rel=1e-3)
    np.testing.assert_array_equal(sky.stars(star)[0], onboard.direction[star])
    # Of more than are kept the oldest ones are forgotten.
    for number in range(200):
        sky.add_observer(10 ** 10 + number, observer_struct(states[2]))
    assert sky.look(10 ** 10 + 199)[1][0] == 20.0


def test_stars_move_with_the_epoch(view):
    _, onboard, file = view
    years, moved_au = 0.4, np.array([0.3, -0.8, 0.1])
    sky = View(native_bank.sky_struct(file), CAMERA, years, moved_au)
    star = np.arange(0, len(onboard), 5)
    moved = (onboard.direction[star] + years * onboard.motion[star].astype(float)
             - onboard.parallax_rad[star, None].astype(float) * moved_au)
    np.testing.assert_allclose(
        sky.stars(star)[0], moved / np.linalg.norm(moved, axis=1, keepdims=True), rtol=0,
        atol=1e-15)


def test_catalogue_numbers_of_stars(view):
    sky, onboard, _ = view
    View(sky._sky, CAMERA)
    hips = np.append(onboard.hip[::50], [0, -5, 2 ** 31 - 1])
    found = [native_bank.call('stt_star_of_hip', int(hip)) for hip in hips]
    np.testing.assert_array_equal(found, onboard.index_of(hips))


@pytest.fixture
def lists(view):
    """Return the view of the lists, opened again: other tests open others."""
    return View(view[0]._sky, CAMERA), view[1]


def test_stars_that_should_be_seen_in_real_frames(lists):
    sky, _ = lists
    for case in record()['visible']:
        uv, velocity = sky.visible(case['q'], case['rate'], case['faintest'])
        np.testing.assert_allclose(uv, case['uv'], **EQUAL)
        np.testing.assert_allclose(velocity, case['velocity'], **EQUAL)


def test_predictions_of_real_frames(lists):
    sky, _ = lists
    for case in record()['predicted']:
        options = case['options']
        found = sky.predict(case['q'], case['covariance'], case['rate'],
                            options['magnitude_limit'], int(1.5 * options['max_stars']))
        np.testing.assert_array_equal(found['hip'], case['hip'])
        for name, expected in (
                ('u_px', case['uv'][:, 0]), ('v_px', case['uv'][:, 1]),
                ('u_rate_px_s', case['velocity'][:, 0]), ('v_rate_px_s', case['velocity'][:, 1]),
                ('sigma_px', case['sigma_px'])):
            np.testing.assert_allclose(found[name], expected, **EQUAL)


def test_new_stars_of_real_frames(lists):
    sky, onboard = lists
    for case in record()['new']:
        star, centroid = sky.new_stars(*(case[name] for name in (
            'q', 'covariance', 'uv', 'flux', 'sigma_px', 'zero_point', 'tolerance')))
        np.testing.assert_array_equal(onboard.hip[star], case['hip'])
        np.testing.assert_array_equal(centroid, case['centroid'])


def test_identified_frames_of_real_runs(lists):
    sky, onboard = lists
    for case in record()['identified']:
        found = sky.fit_identified(case['options'], case['centroids'], case['hip'])
        assert ('found' in case) == isinstance(found, tuple)
        if 'found' in case:
            star, kept, quaternion, covariance, scale = found
            np.testing.assert_array_equal(onboard.hip[star], case['found'])
            np.testing.assert_array_equal(
                np.column_stack([kept['u_px'], kept['v_px']]), case['uv'])
            np.testing.assert_allclose(quaternion, case['q'], rtol=0, atol=1e-12)
            np.testing.assert_allclose(covariance, case['covariance'], rtol=1e-9,
                                       atol=1e-9 * np.abs(case['covariance']).max())
            assert scale == pytest.approx(float(case['scale']), rel=1e-9)


def test_a_frame_that_contradicts_the_tracks(lists):
    sky, _ = lists
    case = next(case for case in record()['identified'] if 'found' in case)
    sky.fit_identified(case['options'], case['centroids'], case['hip'])
    small = 1e-10 * np.eye(3)

    def contradicts(turn_rad, covariance, max_residual_px=1.0):
        x, y, z, w = case['q']
        q = np.array([x + turn_rad / 2 * w, y, z, w - turn_rad / 2 * x])
        return bool(native_bank.call(
            'stt_contradicts', q / np.linalg.norm(q), covariance, max_residual_px))

    assert not contradicts(0.0, small) and contradicts(0.01, small)
    # A small sigma alone, or a poor lens alone, is not a contradiction.
    assert not contradicts(0.01, 1e-3 * np.eye(3))
    assert not contradicts(0.01, small, 50.0)


def test_an_identified_frame_counts_each_star_once(lists):
    sky, onboard = lists
    case = next(case for case in record()['identified'] if 'found' in case)
    centroids = np.concatenate([case['centroids'], case['centroids'][:1]])
    centroids['u_px'][-1] += 100.0
    hip = np.append(case['hip'], case['found'][0])
    found = sky.fit_identified(case['options'], centroids, hip)
    np.testing.assert_array_equal(onboard.hip[found[0]], case['found'])
    assert sky.fit_identified(case['options'], centroids[:2], hip[:2]) == 0
    centroids = case['centroids'].copy()
    centroids['u_px'] += np.random.default_rng(0).normal(0, 30, len(centroids))
    reason = sky.fit_identified(case['options'], centroids, case['hip'])
    assert reason in (0, 303)  # too few that fit, or ST_REASON_MISFIT


def test_faint_stars_explain_spots_too():
    onboard = onboard_stars(CAMERAS[0], 2026.0, 9.0)
    file = native_bank.sky_file(CAMERAS[0], onboard.direction, magnitude=onboard.magnitude)
    sky, rng = View(native_bank.sky_struct(file), CAMERAS[0]), np.random.default_rng(3)
    q = quaternion_from_pointing(*np.radians([80.0, 20.0, 30.0]))
    index, _, uv = sky.in_view(q)
    assert len(index) > 600
    for star in rng.choice(len(index), 20, replace=False):
        beside, _, there = sky.beside(q, uv[star:star + 1], 5.0)
        assert set(index[np.hypot(*(uv - uv[star]).T) < 5.0]) <= set(beside)
        assert np.hypot(*(there - uv[star]).T).min() == 0
    spots, sigma = rng.uniform(5, 500, (200, 2)), rng.uniform(0.01, 1.0, 200)
    spots[:2], sigma[2:4] = np.nan, (0.0, np.nan)
    distance = np.linalg.norm(spots[:, None] - uv, axis=2).min(axis=1)
    expected = np.flatnonzero((distance > np.maximum(2.0, 5 * sigma)) & (sigma > 0))
    assert 20 < len(expected) < 190
    np.testing.assert_array_equal(sky.unexplained(q, spots, sigma, 2.0, 5.0), expected)


# --- motion, fits, starts ---


def test_motion_of_stars():
    for case in record()['motion']:
        camera, dt_s, rate = CAMERAS[int(case['camera'])], case['dt_s'], case['rate']
        uv, variance = case['uv'], case['variance']
        constant = native_bank.star_motion('constant_velocity', dt_s, 0.0, case['noise'])
        np.testing.assert_allclose(np.concatenate(constant), case['constant'], **EQUAL)
        turning = native_bank.star_motion('coordinated_turn', dt_s, 9 * rate[2], case['noise'])
        np.testing.assert_allclose(np.concatenate(turning), case['turning'], **EQUAL)
        np.testing.assert_allclose(
            native_bank.rolled(camera, rate[2], dt_s), case['rolled'], **EQUAL)
        np.testing.assert_allclose(
            native_bank.turn_curvature(camera, uv, rate, dt_s), case['curvature'], **EQUAL)
        moved = native_bank.moved_by(camera, uv, variance, rate, case['P'])
        np.testing.assert_allclose(np.concatenate([
            each.reshape(len(uv), -1) for each in moved], axis=1), case['moved'], **EQUAL)
        np.testing.assert_allclose(
            native_bank.propagated(camera, uv, rate, dt_s), case['propagated'], **EQUAL)
        found = native_bank.body_rate(camera, uv, case['velocity'], case['error'])
        np.testing.assert_allclose(np.vstack(found), case['body_rate'], **SUMS)


def test_no_body_rate_by_one_star():
    assert native_bank.body_rate(CAMERAS[0], [[9.0, 9.0]], [[1.0, 0.0]], np.eye(2)) is None


def test_rates_between_two_frames():
    found = 0
    for case in record()['frames']:
        rate = np.empty(3)
        agree = native_bank.call(
            'stt_rate_between_frames', CAMERAS[int(case['camera'])].native,
            case['before'], len(case['before']), case['after'], len(case['after']), 0.1, rate)
        assert bool(agree) == bool(len(case['rate']))
        if agree:
            np.testing.assert_allclose(rate, case['rate'], rtol=0, atol=1e-12)
            found += 1
    assert found > 4


def test_star_neighbourhoods():
    assigned = 0
    for case in record()['neighbours']:
        found = native_bank.star_neighbourhood(CAMERAS[int(case['camera'])], *(
            case[name] for name in ('predicted', 'icrf', 'uv', 'sigma_px')))
        np.testing.assert_array_equal(found, case['assigned'])
        assigned += np.count_nonzero(found >= 0)
    assert assigned > 50


def test_fits_of_a_rotation():
    for case in record()['fit']:
        solver = native_bank.SOLVERS[int(case['solver'])]
        attitude, figures, normalised, inlier = native_bank.fit_rotation(
            CAMERAS[int(case['camera'])], *(case[name] for name in (
                'icrf', 'uv', 'sigma_px', 'candidate')), solver)
        same_fit(attitude, figures, normalised, case)
        np.testing.assert_array_equal(inlier, case['inlier'])


def same_fit(attitude, figures, normalised, case):
    np.testing.assert_allclose(attitude[:4], case['attitude'][:4], rtol=0, atol=1e-10)
    np.testing.assert_allclose(attitude[4:], case['attitude'][4:], rtol=1e-9,
                               atol=1e-9 * np.abs(case['attitude'][4:]).max())
    np.testing.assert_allclose(figures, case['figures'], rtol=1e-8)
    np.testing.assert_allclose(normalised, case['normalised'], rtol=1e-7, atol=1e-9)


def test_no_fit_of_too_few_stars():
    uv, icrf = np.array([[1.0, 2.0], [3.0, 4.0]]), np.eye(3)[:2]
    for candidate in ([False, False], [True, False]):
        assert native_bank.fit_rotation(CAMERAS[0], icrf, uv, [0.1, 0.1], candidate) is None


def test_starts():
    counts = defaultdict(int)
    for case in record()['starts']:
        first, second, hint = case['first'], case['second'], case['hint']
        found = {
            'two': native_bank.start_of_two(first, case['scales'][0], second, case['scales'][1]),
            'hinted': native_bank.start_of_hint(hint, second, case['scales'][1], 0.6),
            'late': native_bank.start_of_hint(hint, second, case['scales'][1], 0.4),
            'predicted': native_bank.start_of_hint(hint, second, case['scales'][1], 0, False)}
        for name, rates in found.items():
            assert len(rates) == len(case[name]), name
            np.testing.assert_allclose(rates, case[name], rtol=1e-12, atol=1e-18)
            counts[name] += bool(len(rates))
    assert counts['two'] == 12 and not counts['late']
    assert 0 < counts['hinted'] < 12 and 0 < counts['predicted'] < 12


# --- models of stars ---


def test_models_of_stars_in_real_runs():
    """Every column of every track, in the paper's runs and in one where stars come and go."""
    runs = defaultdict(list)
    for case in record()['update']:
        runs[int(case['model'])].append(case)
    good = 0
    for number, start in enumerate(record()['start']):
        before = np.concatenate([case['before'] for case in runs[number]])
        icrf = np.concatenate([case['icrf'] for case in runs[number]])
        # The stars of the run, in a sky of their own.
        stars, first = np.unique(before, return_index=True)
        file = native_bank.sky_file(CAMERA, icrf[first])
        sky = View(native_bank.sky_struct(file), CAMERA)
        model, tracks = native_bank.Model(start['options'], start['hint'], start['roll']), ()
        for case in runs[number]:
            prepare(model, tracks, case, stars)
            updated = model.update(case['stamp_ns'], case['centroids'], case['roll'])
            tracks = updated.tracks
            same_update(updated, case, stars)
            good += updated.good
            same_publication(tracks)
            same_detected(updated)
        del sky
    assert good > 40


def prepare(model, tracks, case, stars):
    """Give a model the tracks that it has before a frame."""
    confirmed = dict(zip(case['before'].tolist(), case['confirmed'].tolist()))
    old = case['before'][:len(case['before']) - len(case['added'])]
    own = [int(stars[int(track['star'])]) for track in tracks]
    model.select(np.isin(own, old), [confirmed.get(star, False) for star in own])
    for star, centroid, is_confirmed in zip(
            case['added'], case['added_centroids'], case['added_confirmed']):
        model.add([np.searchsorted(stars, star)], [centroid], is_confirmed)


def same_update(updated, case, stars):
    tracks, expected = updated.tracks, case['tracks']
    np.testing.assert_array_equal(stars[tracks['star'].astype(int)], expected['star'])
    for name in ('age', 'missed', 'confirmed', 'flux', 'snr', 'sigma_px'):
        np.testing.assert_array_equal(tracks[name], expected[name], err_msg=name)
    for name in ('state', 'covariance', 'variance', 'residual_px', 'probability'):
        np.testing.assert_allclose(tracks[name], expected[name], rtol=1e-9, atol=1e-9,
                                   err_msg=name)
    np.testing.assert_array_equal(updated.unassociated, case['unassociated'])
    np.testing.assert_array_equal(updated.uv[:, 0], case['centroids']['u_px'])
    assert updated.good == bool(case['good']) and updated.has_fit == ('attitude' in case)
    if updated.has_fit:
        same_fit(updated.attitude, updated.figures, updated.normalised, case)
    np.testing.assert_allclose(updated.rate, case['rate'], rtol=0, atol=1e-10)
    np.testing.assert_allclose(updated.rate_covariance, case['rate_covariance'], rtol=1e-9,
                               atol=1e-18)
    assert updated.uses_gyro == bool(case['uses_gyro'])
    assert bool(updated.gyro_trouble) == bool(case['trouble'])


def same_publication(tracks):
    """Compare tracks of the sky of sky_file(): stars 1, 2, 3 ..., all of magnitude 5."""
    count = len(tracks)
    confirmed = tracks['confirmed'] > 0
    seen = confirmed & (tracks['missed'] == 0)
    for identified in (True, False):
        found = np.zeros(count + 1, native.STAR_TRACK)
        assert native_bank.call('stt_publish', int(identified), count + 1, found) == count
        found = found[:count]
        known = confirmed & identified
        np.testing.assert_array_equal(found['hip'], np.where(known, tracks['star'] + 1, 0))
        np.testing.assert_array_equal(found['magnitude'], np.where(known, 5.0, np.nan))
    for name, expected in (
            ('u_px', tracks['state'][:, 0]), ('v_rate_px_s', tracks['state'][:, 3]),
            ('cov_uv_px2', tracks['covariance'][:, 0, 2]), ('flux_dn', tracks['flux']),
            ('residual_px', tracks['residual_px']), ('age', tracks['age']),
            ('association_probability', tracks['probability'])):
        np.testing.assert_array_equal(found[name], expected)
    expected = np.median(5.0 + 2.5 * np.log10(tracks['flux'][seen])) if seen.any() else np.nan
    zero_point = np.empty(1)
    native_bank.call('stt_zero_point', zero_point)
    np.testing.assert_allclose(zero_point, expected, rtol=1e-14)
    kept, after = np.empty(count, np.int32), np.empty(count, np.int32)
    crowded = native_bank.whole(np.arange(count) == 1)
    native_bank.call('stt_keep', crowded, 1.0, 3, kept, after)
    most = np.where(confirmed, 1, tracks['age'] // 2)
    np.testing.assert_array_equal(kept, (crowded == 0) & (tracks['missed'] <= most))
    np.testing.assert_array_equal(
        after, confirmed | ((tracks['missed'] == 0) & (tracks['age'] >= 3)))


def same_detected(updated):
    """Compare detected stars of every second track, by some attitude and rate."""
    tracks, count = updated.tracks, len(updated.tracks)
    q, rate = quaternion_from_pointing(0.1, 0.2, 0.3), np.array([0.01, -0.02, 0.03])
    sensor = np.column_stack([np.linspace(-0.1, 0.1, count), np.zeros(count), np.ones(count)])
    sensor /= np.linalg.norm(sensor, axis=1, keepdims=True)
    distance = np.where(np.arange(count) % 2, np.inf, 0.5)
    best = native_bank.whole(np.arange(count) % len(updated.uv))
    error = np.tile([0.1, 0.02, 0.3], (len(updated.uv), 1))
    found = np.empty((count, 16))
    found = found[:native_bank.call(
        'stt_detected_stars', q, rate, rotate(q, sensor), distance, best, updated.uv, error,
        len(error), found)]
    seen = np.flatnonzero((tracks['confirmed'] > 0) & np.isfinite(distance))
    flow = np.empty((count, 2, 3))
    native_bank.call('st_image_flow', CAMERA.native, sensor, flow, count)
    np.testing.assert_array_equal(found[:, 0], seen)
    uv = updated.uv[best[seen]]
    expected = np.column_stack([
        uv, uv - tracks['state'][seen][:, [0, 2]], error[:len(seen)],
        flow[seen].reshape(-1, 6), flow[seen] @ rate])
    np.testing.assert_allclose(found[:, 1:], expected, rtol=1e-9, atol=1e-9)

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The native identification of lists of all kinds: its record, slices, stops, and wrong use."""

import ctypes
import math
import threading

from limits import HANGS_S
from native_core import kernels
from native_identification import CAMERAS, EPOCH_YEAR, identifiers, RECORD
import numpy as np
import pytest
from skies import onboard_stars
from startracker_ros.core import native
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.sky_file import sky_arrays
from startracker_ros.core.identify.star_matcher import Rules, StarMatcher
from startracker_ros.core.maths.rotation import attitude_error, matrix_from_quaternion
from startracker_ros.core.stored_arrays import write_arrays

IDENTIFIED, SEARCHING, TIME_LIMIT = 1, 6, 5
FEW_TRUE = 0.2
STOPPED = 205  # ST_REASON_STOPPED


@pytest.fixture(scope='module')
def record():
    with np.load(RECORD) as stored:
        return dict(stored)


@pytest.fixture(scope='module')
def lists(record):
    """Return the lists, and the rows of each among all stars of the record."""
    ends = np.cumsum(record['count'])
    found = []
    for end, count, sigma_px in zip(ends, record['count'], record['sigma_px']):
        rows = slice(end - count, end)
        found.append((Centroids(record['uv'][rows].astype(float),
                                record['flux'][rows].astype(float), np.full(count, 50.0),
                                np.full(count, float(sigma_px))), rows))
    return found


@pytest.mark.parametrize('camera', CAMERAS)
def test_lists_of_all_kinds_have_the_stars_of_the_record(record, lists, camera):
    identifier, compared = identifiers()[camera], 0
    for number in np.flatnonzero(record['names'][:, 0] == camera):
        centroids, rows = lists[number]
        found = identifier.identify(centroids)
        ratio, log_chance, *numbers = record['figures'][number]
        right = (found.hip == record['hip'][rows]) | (found.hip == 0)
        if record['status'][number] != 'identified':
            # More may be found, but nothing that is wrong.
            assert found.attitude is None or right.all()
            continue
        if np.count_nonzero(record['hip'][rows]) < FEW_TRUE * len(centroids):
            # So few true stars are searched for a while only.
            assert found.attitude is None or right.all()
            continue
        compared += 1
        assert found.status == 'identified'
        np.testing.assert_array_equal(found.hip, record['found'][rows])
        # The triangle that led to them may be another one: far less than any noise.
        np.testing.assert_allclose(found.residual_px, record['residual_px'][rows], atol=5e-3)
        assert found.focal_ratio == pytest.approx(ratio, abs=1e-5)
        quaternion, sigma_rad = np.array(numbers[4:8]), np.array(numbers[8:])
        assert (np.abs(attitude_error(found.attitude.quaternion, quaternion))
                < 0.02 * sigma_rad).all()
        np.testing.assert_allclose(np.sqrt(np.diag(found.attitude.covariance_sensor)), sigma_rad,
                                   rtol=1e-3)
        assert np.log(max(found.false_alarm_probability, 1e-300)) == pytest.approx(
            log_chance, abs=30)
    assert compared > 35


def test_stars_in_the_circle_of_a_fisheye_are_counted(monkeypatch):
    """The image is wider than the circle of sin(theta), beyond which a pixel has no direction."""
    monkeypatch.setattr(native, 'library', kernels)
    camera = Camera(800, 600, 250.0, 250.0, 410.0, 290.0,
                    (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880), 'equidistant')
    onboard = onboard_stars(camera, 2026.0, 5.0)
    matrix = matrix_from_quaternion([0.1, 0.3, -0.2, 0.9])
    seen = camera.contains(camera.project(onboard.direction @ matrix)).sum()
    count = kernels().stt_stars_in_image(
        StarMatcher(camera, onboard, {}, Rules(0.005))._tracker.handle, matrix.ctypes.data)
    # With those in the corners of the square about the circle.
    assert 500 < seen <= count < 1.5 * seen


# --- a tracker of the flight interface, with a sky file ---


class Flight:
    """A tracker of the stage ST_IDENTIFIES."""

    def __init__(self, camera, sky, **options):
        self.library = native.library()
        self.config, self.camera = native.defaults(), camera.native.copy()
        self.config['stages'] = 2
        self.config['capacities']['centroids'] = 1000
        for name, value in options.items():
            self.config['identification'][name] = value
        self.sky = np.array((sky.ctypes.data, len(sky)), native.SKY)
        self.size, self.tracker = ctypes.c_size_t(), ctypes.c_void_p()
        given = self.config.ctypes.data, self.camera.ctypes.data, self.sky.ctypes.data
        native.check(self.library.st_size(*given, ctypes.byref(self.size)))
        block = np.empty(self.size.value + 64, np.uint8)
        self.memory = block[-block.ctypes.data % 64:][:self.size.value]
        native.check(self.library.st_create(
            self.memory.ctypes.data, self.size.value, *given, ctypes.byref(self.tracker), None))
        self.found = np.zeros((), native.IDENTIFICATION)

    def identify(self, centroids, slice_s=math.inf, stop=None):
        """Return the status of a call."""
        table = np.zeros(len(centroids), native.CENTROID)
        table['u_px'], table['v_px'] = centroids.uv.T
        table['flux_dn'], table['sigma_px'] = centroids.flux, centroids.sigma_px
        return self.library.st_identify(self.tracker, 7, table.ctypes.data, len(table), slice_s,
                                        stop, self.found.ctypes.data)

    def go_on(self, slice_s=math.inf, stop=None):
        return self.library.st_identify_on(self.tracker, slice_s, stop, self.found.ctypes.data)

    def numbers(self):
        """Return the numbers of the stars."""
        count = ctypes.c_size_t()
        first = self.library.st_identified_stars(self.tracker, ctypes.byref(count))
        size = count.value * native.IDENTIFIED.itemsize
        return np.frombuffer(ctypes.string_at(first, size) if size else b'', native.IDENTIFIED)


@pytest.fixture(scope='module')
def sky(tmp_path_factory):
    path = tmp_path_factory.mktemp('sky') / 'sky.st'
    with path.open('wb') as opened:
        write_arrays(opened, sky_arrays(CAMERAS['12 deg'], EPOCH_YEAR))
    native.check_sky(path)
    return np.memmap(path, np.uint8, 'r')


def of_kind(record, lists, kind):
    """Return the lists of a kind of the camera of 12 deg."""
    return [lists[number] for number in np.flatnonzero(
        (record['names'] == ['12 deg', kind]).all(1))]


def test_with_a_sky_file_the_same_stars_are_found(record, lists, sky):
    flight = Flight(CAMERAS['12 deg'], sky)
    for kind in ('clean', '30 false', '5 stars'):
        for centroids, rows in of_kind(record, lists, kind):
            native.check(flight.identify(centroids))
            if flight.found['status'] != IDENTIFIED:
                continue
            np.testing.assert_array_equal(flight.numbers()['hip'], record['found'][rows])
            attitude = flight.found['attitude']
            assert attitude['valid'] == 1 and attitude['stamp_ns'] == 7
            assert attitude['stars'] == np.count_nonzero(record['found'][rows])
            assert np.isnan(attitude['rate_rad_s']).all()
            number = int(np.searchsorted(np.cumsum(record['count']), rows.stop))
            sigma_rad = np.sqrt(np.diag(attitude['covariance_rad2']))
            error = attitude_error(attitude['quaternion'], record['figures'][number, 2:6])
            assert (np.abs(error) < 5 * sigma_rad).all()
        assert flight.found['status'] == IDENTIFIED


@pytest.mark.parametrize('slice_s', [1e-9, 2e-4])
def test_a_search_in_slices_has_the_same_result(record, lists, sky, slice_s):
    flight, longest_s = Flight(CAMERAS['12 deg'], sky), 0.0
    for kind in ('30 false', 'no sky'):
        for centroids, _ in of_kind(record, lists, kind)[:3]:
            native.check(flight.identify(centroids))
            whole, numbers = flight.found.copy(), flight.numbers().copy()
            native.check(flight.identify(centroids, slice_s))
            before_s = 0.0
            while flight.found['status'] == SEARCHING:
                assert not len(flight.numbers()) and not flight.found['attitude']['valid']
                longest_s = max(longest_s, float(flight.found['work_s']) - before_s)
                before_s = float(flight.found['work_s'])
                native.check(flight.go_on(slice_s))
            assert flight.found.tobytes() == whole.tobytes()
            assert flight.numbers().tobytes() == numbers.tobytes()
    # No slice is longer than by the parts in which work is counted.
    assert 0 < longest_s < slice_s + 1e-3


def test_a_search_is_stopped_by_another_thread(record, lists, sky):
    flight = Flight(CAMERAS['12 deg'], sky, most_work_s=600.0)
    rng = np.random.default_rng(3)
    spots = Centroids(rng.uniform(0, 1023, (300, 2)), np.arange(300.0), np.ones(300),
                      np.full(300, 0.3))
    stop = np.zeros(1, np.uint32)
    timer = threading.Timer(0.01, lambda: stop.fill(1))
    timer.start()
    native.check(flight.identify(spots, stop=stop.ctypes.data))
    timer.join(HANGS_S)
    assert flight.found['status'] == TIME_LIMIT
    assert flight.found['reason']['code'] == STOPPED
    assert flight.go_on() != 0


def test_wrong_use_is_refused_and_changes_nothing(record, lists, sky):
    flight = Flight(CAMERAS['12 deg'], sky)
    centroids, _ = of_kind(record, lists, 'clean')[0]
    assert flight.go_on() != 0
    assert flight.identify(centroids, slice_s=math.nan) != 0
    many = Centroids(np.zeros((9999, 2)), np.zeros(9999), np.zeros(9999), np.zeros(9999))
    assert flight.identify(many) != 0
    native.check(flight.identify(centroids))
    assert flight.found['status'] == IDENTIFIED
    other = Camera.from_fov(1024, 1024, 20.0)
    with pytest.raises(native.NativeError, match='sky'):
        Flight(other, sky)


def test_no_content_of_a_list_is_wrong_use(sky):
    flight = Flight(CAMERAS['12 deg'], sky, most_work_s=0.01)
    rng = np.random.default_rng(4)
    strange = [0.0, -1.0, 1e-300, 1e300, np.nan, np.inf, -np.inf, 512.0]
    for _ in range(300):
        count = int(rng.integers(0, 60))
        columns = rng.uniform(-100, 1100, (5, count))
        places = rng.random(columns.shape) < 0.2
        columns[places] = rng.choice(strange, np.count_nonzero(places))
        with np.errstate(over='ignore'):
            centroids = Centroids(columns[:2].T, columns[2], columns[3], columns[4])
        native.check(flight.identify(centroids))
        assert 0 <= flight.found['status'] <= SEARCHING

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The public library: what it loads, that it equals command and pipeline, what it rejects."""

import json
from pathlib import Path
import subprocess
import sys

from commands import invoke
from limits import HANGS_S
import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
import startracker_ros as st
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.images.images import read_image
from startracker_ros.tools.figures.correctness import error_over_bound

START_NS, STEP_NS = stamp_from_epoch_year(2026.5), 100_000_000


def photographs(sky_data):
    return sorted((sky_data / 'night-sky-11deg').glob('*.png'))


def over_bound(attitude, state):
    return error_over_bound(attitude.quaternion, attitude.covariance_sensor,
                            state.q_icrf_from_sensor)


@pytest.fixture(scope='module')
def frames():
    sky = st.SkySimulator(CAMERA, 2026.5, motion='constant_rate', ra_deg=200.0, dec_deg=25.0,
                          rate_deg_s=(0.1, 0.0, 0.0), aberration=False)
    return [sky.frame(index / 10) for index in range(8)]


def test_names_load_when_they_are_used():
    code = ('import sys, startracker_ros as st; '
            'print(*{"numpy", "numba", "rclpy"} & set(sys.modules)); '
            'assert set(st.__all__) == set(st._MODULES); '
            'print(*st.__all__); print(*dir(st)); '
            '[getattr(st, name) for name in st.__all__]; '
            'print("rclpy" in sys.modules, callable(st.identify))')
    shown = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                           check=True, timeout=HANGS_S).stdout.splitlines()
    assert shown[0] == '' and set(shown[1].split()) <= set(shown[2].split())
    assert shown[3] == 'False True'
    assert (Path(st.__file__).parent / 'py.typed').is_file()
    with pytest.raises(AttributeError, match='no_such_name'):
        st.no_such_name  # noqa: B018


def test_solve_equals_the_command_in_any_order(sky_data):
    first, second = photographs(sky_data)[:2]
    command = invoke('solve', str(first), '--fov-deg', '11.4', '--epoch', '2019.57', '--json')
    row, = json.loads(command.stdout)['rows']
    st.solve(second, fov_deg=11.4, epoch=2019.57)
    solution = st.solve(read_image(first), 11.4, 2019.57)
    assert solution.solved and row['solved']
    for name in ('ra_deg', 'dec_deg', 'roll_deg', 'fov_deg', 'residual_arcsec', 'matched',
                 'reason'):
        assert getattr(solution, name) == row[name], name
    assert solution.quaternion.tolist() == row['quaternion']
    assert solution.covariance_sensor.ravel().tolist() == row['covariance_sensor']
    assert solution.false_alarm == row['false_alarm_probability']
    # Without a time the velocity of the Earth is in the covariance.
    undated = st.solve(read_image(first), 11.4)
    sigma = np.sqrt(np.diag(undated.covariance_sensor))
    assert (sigma[:2] > 12 * ARCSEC).all()
    assert (np.abs(attitude_error(undated.quaternion, solution.quaternion)) < 3 * sigma).all()


def test_star_tracker_equals_the_truth(frames):
    tracker = st.StarTracker(CAMERA, 2026.5, aberration='none')
    found = 0
    for index, frame in enumerate(frames):
        stamp_ns = START_NS + index * STEP_NS
        result = tracker.process(stamp_ns, frame.image)
        if result.attitude is None:
            assert result.reason
            continue
        found += 1
        assert not result.reason
        assert over_bound(result.attitude, frame.state) < 1
        if index + 1 < len(frames):
            later = result.attitude.at(stamp_ns + STEP_NS)
            assert over_bound(later, frames[index + 1].state) < 1
            assert (np.trace(later.covariance_sensor)
                    > np.trace(result.attitude.covariance_sensor))
    assert found >= len(frames) - 2
    late = tracker.process(stamp_ns, frame.image)
    assert late.attitude is None and 'not newer' in late.reason
    tracker.reset()
    assert tracker.process(START_NS, frames[0].image).state == 'ACQUIRING'


def test_an_identification_that_begins_anew_leaves_the_attitude_of_its_frame(frames):
    class Contradicted(st.StarTracker):
        def identify(self, stamp_ns, centroids):
            tracks = self.tracker.state == 'TRACKING'
            found = super().identify(stamp_ns, centroids)
            if tracks:
                self.tracker.reset()
            return found

    tracker = Contradicted(CAMERA, 2026.5, aberration='none', check_period_s=0.1)
    results = [tracker.process(START_NS + index * STEP_NS, frame.image)
               for index, frame in enumerate(frames)]
    published = [result for result in results if result.attitude is not None]
    assert published and published[0].state == 'LOST'
    assert published[0].attitude.at(published[0].stamp_ns + STEP_NS).cross_covariance is not None


def test_single_stages(frames):
    found = st.extract(frames[0].image, max_stars=30)
    identified = st.identify(found.centroids, CAMERA, epoch_year=2026.5, aberration='none')
    assert identified.status == 'identified' and len(found.centroids) <= 30
    assert over_bound(identified.attitude, frames[0].state) < 1
    result = st.StarTracker(CAMERA, 2026.5).process_centroids(START_NS, found.centroids)
    assert result.identification.status == 'identified'


@pytest.mark.parametrize('options, text', [
    ({'max_star': 3}, 'unknown option max_star, did you mean max_stars'),
    ({'max_stars': 0}, 'max_stars = 0 is out of range'),
    ({'method': 'quad'}, "star_identifier={'method': ...}"),
    ({'star_identifier': {'mode': 1}}, 'star_identifier: unknown option mode'),
    ({'star_identifier': 3}, 'must be a dict')])
def test_wrong_options_are_named(options, text):
    with pytest.raises(ValueError) as raised:
        st.StarTracker(CAMERA, 2026.5, **options)
    assert text in str(raised.value)


def test_wrong_input_is_named():
    tracker = st.StarTracker(CAMERA, 2026.5, star_identifier={'method': 'pyramid'})
    for image, text in ((np.zeros((512, 512)), 'float64'),
                        (np.zeros((4, 512), np.uint8), '512 x 4 px'),
                        (np.zeros((512, 512, 3), np.uint8), '3 dimensions')):
        with pytest.raises(ValueError, match=text):
            tracker.process(0, image)
    with pytest.raises(ValueError, match='rate_rad_s'):
        tracker.add_rate(0, [1.0, 2.0])
    with pytest.raises(ValueError, match='Centroids'):
        tracker.process_centroids(0, np.zeros((3, 2)))
    with pytest.raises(ValueError, match='unknown option filter'):
        st.extract(np.zeros((64, 64), np.uint8), filter=1)
    with pytest.raises(ValueError, match='either fov_deg or camera'):
        st.solve(np.zeros((64, 64), np.uint8), fov_deg=10.0, camera=CAMERA)

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The public library: what it loads, that it equals command and pipeline, what it rejects."""

from datetime import datetime
import inspect
import json
from pathlib import Path
import re
import subprocess
import sys
import warnings

from astropy.wcs import WCS
from commands import invoke
import cv2
from limits import HANGS_S
import numpy as np
import pytest
from scipy.spatial import cKDTree
from skies import SMALL_CAMERA as CAMERA
import startracker_ros as st
from startracker_ros.core.astro.epoch import julian_year, stamp_from_epoch_year
from startracker_ros.core.catalog.deep import load_deep_catalog
from startracker_ros.core.catalog.onboard import MERGE_PX
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error
from startracker_ros.io.images.images import read_image
from startracker_ros.photographs.sip import wcs_header
from startracker_ros.tools.figures.correctness import error_over_bound

ROOT = Path(__file__).parents[1]
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
            'print(*{"numpy", "rclpy"} & set(sys.modules)); '
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

    tracker = Contradicted(CAMERA, 2026.5, aberration='none', check_period_s=0.1,
                           star_identifier={'method': 'quad'})
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


EPOCHS = {
    1.78e9: 'as a UNIX time in s it is 2026.4', 1.78e18: 'as a UNIX time in ns it is 2026.4',
    2461200.5: 'as a Julian date it is 2026.44',
    61200.0: 'as a modified Julian date it is 2026.44',
    20190729: "as a date it is the text '2019-07-29'", 3e5: 'as 2026.5 is$', -5.0: 'as 2026.5 is$',
    float('nan'): 'not a Julian year', 'noon': 'neither a year nor a time', None: 'NoneType'}


@pytest.mark.parametrize('epoch', EPOCHS)
@pytest.mark.parametrize('use', [
    lambda epoch: st.StarTracker(CAMERA, epoch), lambda epoch: st.SkySimulator(CAMERA, epoch),
    lambda epoch: st.identify(st.Centroids.empty(), CAMERA, epoch_year=epoch),
    lambda epoch: st.solve(np.zeros((64, 64), np.uint8), epoch=epoch)])
def test_an_epoch_in_another_unit_is_named(use, epoch):
    if epoch is None and 'solve' in use.__code__.co_names:
        return
    with pytest.raises(ValueError, match=EPOCHS[epoch]):
        use(epoch)


def test_an_epoch_is_a_year_or_a_time_everywhere():
    year, = {julian_year(epoch) for epoch in (
        '2026-07-02T12:00', '2026-07-02T12:00:00Z', '2026-07-02T14:00+02:00',
        datetime(2026, 7, 2, 12))}
    assert year == pytest.approx(2026.5, abs=1e-3)
    assert {julian_year(epoch) for epoch in (2026, '2026', np.float32(2026))} == {2026.0}


@pytest.mark.parametrize('stamp', [1.782e18, 1782864000.1, np.float64(5), '5', True, None])
def test_stamps_are_integers(frames, stamp):
    tracker = st.StarTracker(CAMERA, 2026.5, aberration='none')
    for use in (lambda: tracker.process(stamp, frames[0].image),
                lambda: tracker.process_centroids(stamp, st.Centroids.empty()),
                lambda: tracker.add_rate(stamp, np.zeros(3)),
                lambda: tracker.add_observer(stamp, [7e6, 0, 0], [0, 7.5e3, 0])):
        with pytest.raises(ValueError, match='must be UNIX time in ns as an int'):
            use()
    # NumPy's are.
    assert tracker.process(np.int64(START_NS), frames[0].image).stamp_ns == START_NS


def test_stamps_in_seconds_are_named(frames):
    tracker = st.StarTracker(CAMERA, 2026.5, aberration='none')
    with pytest.raises(ValueError, match='1970-01-01T00:00:01.*in s it is of the epoch'):
        tracker.process(START_NS // 10 ** 9, frames[0].image)
    # Of simulated time, from 0.
    for stamp_ns in (0, 1_700_000_000, 1_790_000_000):
        tracker.process(stamp_ns, frames[0].image)


def test_a_camera_has_whole_pixels():
    for width in (512.0, np.float32(512), np.int16(512)):
        camera = st.Camera.from_fov(width, width, 12.0)
        assert camera == CAMERA and type(camera.width) is int
    for width in (512.5, float('nan'), float('inf'), '512'):
        for make in (lambda: st.Camera.from_fov(width, 512, 12.0),  # noqa: B023
                     lambda: st.Camera(512, width, 2e3, 2e3, 256.0, 256.0)):  # noqa: B023
            with pytest.raises(ValueError, match='must be a whole number of px'):
                make()


@pytest.mark.parametrize('base, stars, text', [
    ([0, 1, 2], [[5, 6, 10 ** 6]], 'Candidates.stars has rows from 5 to 1000000, there are'),
    ([0, 1, 2], [[5, 6, -1]], 'rows from -1 to 6'),
    ([0, 1, 99], [[5, 6, 7]], 'Candidates.base has rows from 0 to 99')])
def test_a_method_of_ones_own_that_names_no_star_is_named(frames, base, stars, text):
    class Wrong(st.CandidateIdentifier):

        def candidates(self, field):
            yield st.Candidates(np.array(base), np.array(stars))

    centroids = st.extract(frames[0].image, max_stars=30).centroids
    with pytest.raises(ValueError, match=text):
        st.identify(centroids, CAMERA, epoch_year=2026.5, method=Wrong)


def test_arrays_are_taken_as_files_of_them_are(sky_data, tmp_path):
    path = photographs(sky_data)[0]
    grey = read_image(path)
    expected = st.solve(path, 11.4, '2019-07-29')
    assert expected.solved
    colours = np.dstack([grey, grey, grey])
    for image in (colours, np.dstack([colours, np.full_like(grey, 255)]), grey[..., None]):
        found = st.solve(image, 11.4, '2019-07-29')
        np.testing.assert_array_equal(found.quaternion, expected.quaternion)
    # Of another depth other pixels are saturated.
    for image in (grey / 255, colours.astype(np.float32), 500 + grey.astype('>f8'),
                  grey.astype(np.int32), grey.astype('>u2'), colours.astype(np.uint16)):
        found = st.solve(image, 11.4, 2019.573)
        assert found.matched == expected.matched
        assert found.ra_deg == pytest.approx(expected.ra_deg, abs=0.003)
        assert len(st.extract(image).centroids) == pytest.approx(
            len(st.extract(grey).centroids), rel=0.2)
    for image, text in ((grey.astype(complex), 'complex128'), (grey[:5, :5, None, None], 'shape'),
                        (grey[..., None].repeat(2, 2), r'\(H, W, 3\)'), ('no.png', 'no.png'),
                        ([[1, 2]], 'list'), (np.full((64, 64), np.nan), 'no finite pixel'),
                        (np.zeros((0, 5)), 'empty')):
        with pytest.raises(ValueError, match=text):
            st.solve(image)


def test_wrong_input_is_named():
    tracker = st.StarTracker(CAMERA, 2026.5, star_identifier={'method': 'pyramid'})
    for rate, text in (([1000.0, 0, 0], '57296 deg/s, more than any gyro.*must be in rad/s'),
                       ([np.nan, 0, 0], 'three finite numbers'), ('fast', 'three finite')):
        with pytest.raises(ValueError, match=text):
            tracker.add_rate(0, rate)
    # A gyro at the end of its range is not a mistake.
    tracker.add_rate(0, [8.0, 0.0, 0.0])
    with pytest.raises(ValueError, match='ndarray, must be Centroids: extract'):
        st.identify(np.zeros((3, 2)), CAMERA, epoch_year=2026.5)
    with pytest.raises(ValueError, match='camera is of type str, must be Camera: .*load_camera'):
        st.StarTracker('camera.yaml', 2026.5)
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


@pytest.fixture(scope='module')
def solution(sky_data):
    return st.solve(photographs(sky_data)[0], 11.4, '2019-07-29T20:47:26Z')


def test_a_solution_annotates_its_image_as_the_command_does(sky_data, solution, tmp_path):
    path = photographs(sky_data)[0]
    invoke('solve', str(path), '--fov-deg', '11.4', '--epoch', '2019-07-29T20:47:26Z',
           '--annotate', str(tmp_path), '--wcs', str(tmp_path))
    written = cv2.imread(str(tmp_path / f'{path.stem}.png'))[..., ::-1]
    np.testing.assert_array_equal(solution.annotate(path.stem), written)
    assert (tmp_path / f'{path.stem}.wcs').read_bytes() == wcs_header(solution.wcs())


def test_stars_are_where_wcs_and_catalogue_have_them(solution):
    stars = solution.stars
    assert len(stars) == solution.matched and (np.diff(stars['flux_dn']) <= 0).all()
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        wcs = WCS(solution.wcs())
    np.testing.assert_allclose(wcs.all_world2pix(stars['ra_deg'], stars['dec_deg'], 0),
                               (stars['u_px'], stars['v_px']), atol=0.01)
    catalog = load_deep_catalog().brighter_than(9.0)
    row = [np.flatnonzero(catalog.hip == hip).item() for hip in stars['hip']]
    # A star is all light that the pixels do not resolve, at its centre, to some depth.
    direction, flux = catalog.directions(solution.epoch_year), 10 ** (-0.4 * catalog.magnitude)
    near = cKDTree(direction).query_ball_point(
        direction[row], MERGE_PX * solution.camera.pixel_rad)
    np.testing.assert_allclose(
        stars['magnitude'], [-2.5 * np.log10(flux[rows].sum()) for rows in near], atol=1e-5)
    centre = np.array([flux[rows] @ direction[rows] for rows in near])
    centre /= np.linalg.norm(centre, axis=1, keepdims=True)
    ra, dec = np.radians([stars['ra_deg'], stars['dec_deg']])
    seen = np.stack([np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)], -1)
    off_arcsec = np.linalg.norm(seen - centre, axis=1) / ARCSEC
    assert np.sqrt(np.mean(off_arcsec ** 2)) == pytest.approx(solution.residual_arcsec, rel=0.02)
    pixel_arcsec = solution.camera.pixel_rad / ARCSEC
    np.testing.assert_allclose(stars['residual_px'] * pixel_arcsec, off_arcsec, atol=0.1)


def test_without_an_attitude_there_is_a_picture_and_no_wcs():
    unsolved = st.solve(np.zeros((256, 256), np.uint8))
    assert unsolved.stars.dtype.names[0] == 'hip' and not len(unsolved.stars)
    assert unsolved.annotate().shape[1:] == (256, 3)
    with pytest.raises(st.NoSolutionError, match='all pixels are 0 DN'):
        unsolved.wcs()
    assert repr(unsolved) == "Solution(solved=False, reason='all pixels are 0 DN')"


def test_results_print_as_one_line_and_as_a_table(solution, frames):
    tracker = st.StarTracker(CAMERA, '2026-07-02T12:00:00Z', aberration='none')
    results = [tracker.process(START_NS + index * STEP_NS, frame.image)
               for index, frame in enumerate(frames[:4])]
    for result in (solution, results[0], results[-1]):
        shown = repr(result)
        assert '\n' not in shown and len(shown) < 250, shown
        assert shown.startswith(f'{type(result).__name__}(')
        table = result._repr_html_()
        assert table.count('<tr>') == table.count('</tr>') == len(result.summary())
    assert f'matched={solution.matched}' in repr(solution)
    assert 'quaternion=[' in repr(results[-1]) and 'reason=' in repr(results[0])


def test_errors_are_public_and_wrong_values():
    errors = [name for name in st.__all__ if name.endswith('Error')]
    assert len(errors) == 6
    assert all(issubclass(getattr(st, name), ValueError) for name in errors)
    with pytest.raises(st.CameraError):
        st.Camera.from_fov(512, 512, 400.0)
    with pytest.raises(st.ImageError):
        st.solve('no.png')
    with pytest.raises(st.CalibrationError):
        st.calibrate([np.zeros((64, 64), np.uint8)] * 2, 10.0)


def public():
    """Yield the names of docs/api.md and what they are: public names, members of classes."""
    for name, members in re.findall(r'::\s+startracker_ros\.(\w+)\n(?:\s+:members: (.*)\n)?',
                                    (ROOT / 'docs' / 'api.md').read_text()):
        yield name, getattr(st, name)
        for member in filter(None, members.split(', ')):
            yield f'{name}.{member}', inspect.getattr_static(getattr(st, name), member)


def test_the_reference_has_every_public_name():
    assert {name for name, _ in public() if '.' not in name} == set(st.__all__)


@pytest.mark.parametrize('name, thing', [*public()], ids=[name for name, _ in public()])
def test_arguments_results_and_errors_are_described(name, thing):
    text = inspect.getdoc(thing)
    if isinstance(thing, property) or name.endswith('Error'):
        assert text
        return
    function = getattr(thing, '__func__', thing)
    parameters = [each for each in inspect.signature(function).parameters.values()
                  if each.name not in ('self', 'cls')]
    described = re.findall(r'^    \**(\w+): ', text, re.MULTILINE)
    # Of a base class there are no instances.
    if not inspect.isabstract(thing):
        assert {each.name for each in parameters} <= {*described}, text
    if not isinstance(thing, type) and function.__annotations__.get('return'):
        assert '\nReturns:\n' in text, text

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A small data sheet from images to the page, files of optics, and designs."""

from dataclasses import replace
import json
from pathlib import Path

from browser import assert_readable
from commands import invoke
import numpy as np
from PIL import Image
import pytest
from skies import CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, random_attitude
from startracker_ros.tools import parallel
from startracker_ros.tools.datasheet import datasheet, design
from startracker_ros.tools.datasheet.calibrated import field_errors
from startracker_ros.tools.datasheet.design_options import DesignOptions
from startracker_ros.tools.datasheet.instrument import (
    DETECTOR, Instrument, load_optics, OpticsError, Pointings, RUN_S, Spins)
from startracker_ros.tools.datasheet.rows import (
    consistency_rows, lines_of, rates_of, records, SheetRow)
from startracker_ros.tools.datasheet.single_images import image_errors
from startracker_ros.tools.datasheet.sky_coverage import field_magnitudes, star_counts
from startracker_ros.tools.datasheet.tracked_runs import RunCase, Runs
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

SMALL = Camera.from_fov(384, 384, 10.0)
EFFORT = datasheet.Effort(2, 5, 2, 1, 12, 1, 1, 2, 20, 2)


def test_a_spin_turns_as_its_rate_says():
    rng = np.random.default_rng(1)
    q = np.array([random_attitude(rng) for _ in range(2)])
    motion = Spins(q, np.array([[1.0, 0, 0], [0, 1.0, 0]]), 0.02, 0.05, 1.0)
    step_s = 1e-4
    for time_s in (0.5, 1.5, RUN_S + 0.3, RUN_S + 2.0):
        state = motion.at(time_s)
        turned = attitude_error(motion.at(time_s + step_s / 2).q_icrf_from_sensor,
                                motion.at(time_s - step_s / 2).q_icrf_from_sensor)
        assert turned / step_s == pytest.approx(state.rate_rad_s, abs=1e-9)
    assert motion.at(2.0).rate_rad_s[0] == pytest.approx(0.07)
    still = Pointings(q, np.zeros((2, 3)))
    assert (still.at(1.0).q_icrf_from_sensor == q[1]).all()


def test_errors_of_images_are_those_of_a_star_tracker():
    errors = image_errors(Instrument(SMALL, SMALL), 0.0, 2, 1)
    assert errors.identified.all()
    noise, bound = np.sqrt(np.mean(errors.noise[..., :2] ** 2)), np.sqrt(errors.bound[..., 0])
    assert 0.5 * bound.min() < noise < 3 * bound.max()
    assert np.abs(errors.spatial[..., :2]).max() < 2 * ARCSEC


def test_errors_of_a_calibration_are_those_of_images_with_that_camera():
    # Off the axis by a pixel, and barrel-shaped by 0.4 px in the corner.
    wrong = Instrument(SMALL, replace(SMALL, cx=SMALL.cx + 1, distortion=(0.1, 0, 0, 0, 0)))
    images = image_errors(wrong, 0.0, 3, 1).spatial - image_errors(
        Instrument(SMALL, SMALL), 0.0, 3, 1).spatial
    moved = images.mean(axis=(0, 1)) / SMALL.pixel_rad
    assert np.abs(moved[:2]) == pytest.approx([0, 1], abs=0.1)
    fields, = field_errors(wrong, (0.0,), 300, 1)
    scatter = fields.std(axis=0)
    # Each field of images is one of the distribution.
    assert (np.abs(images.mean(axis=1) - fields.mean(axis=0)) < 4 * scatter).all()
    assert (np.abs(images.mean(axis=1) - fields.mean(axis=0)).max(axis=0) > scatter / 10).all()
    exact, = field_errors(Instrument(SMALL, SMALL), (0.0,), 10, 1)
    assert np.abs(exact).max() < 1e-6 * ARCSEC


def test_stars_in_the_field_are_those_of_the_catalogue():
    magnitudes = field_magnitudes(SMALL, 6.5, 200, 1)
    # 8,785 stars to V 6.5 on 41,253 square degrees.
    assert star_counts(magnitudes, 6.5).mean() == pytest.approx(100 * 8785 / 41253, rel=0.1)
    assert (star_counts(magnitudes, 4.0) <= star_counts(magnitudes, 6.0)).all()


@pytest.fixture(scope='module')
def sheet_and_result(tmp_path_factory):
    """Return the page of a data sheet at one rate, and its result."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        return _small_sheet(tmp_path_factory.mktemp('sheet'), monkeypatch)


def _small_sheet(tmp_path, monkeypatch):
    monkeypatch.setattr(datasheet, 'RATES_DEG_S', (0.0,))
    monkeypatch.setattr(datasheet, 'LIMIT_CASES', ())
    monkeypatch.setattr(datasheet, 'DISTURBANCES', datasheet.DISTURBANCES[:1])
    # In this process: a pool would import all again.
    monkeypatch.setattr(parallel, 'parallel_map', lambda work, pieces, **_: [
        work(*piece) for piece in pieces])
    page = tmp_path / 'sheet.html'
    return page, datasheet.run_datasheet(SMALL, DETECTOR, page, seed=1, effort=EFFORT)


def test_a_page_holds_all_rows(sheet_and_result):
    sheet, result = sheet_and_result
    rows = {row.case: row for row in result.rows}
    assert rows['temporal noise, 0 deg/s, cross boresight'].bound > 0
    assert rows['wrong attitudes, all rates'].ours == 0
    assert rows['frames beyond 5 sigma, 0 deg/s'].goal == '<= 0.01, met'
    assert rows['frames beyond the protection level, 0 deg/s'].goal == '<= 3e-05, met'
    assert rows['thermo-elastic error'].method == 'not simulated'
    assert rows['temporal noise, 0 deg/s, about boresight'].published == 70.0
    assert rows['bias, 0 deg/s, cross boresight'].three_sigma > 0
    text = sheet.read_text()
    for line in lines_of(result.rows):
        assert f'<td>{line.case}</td>' in text, line.case
    assert text.count('data:image/svg+xml;base64,') == 4
    assert 'ST-16RT2' in text and '<script' not in text and '://' not in text
    document = json.dumps(result.records)
    assert 'NaN' not in document


def runs(error_scale, protection_sigma, count=40, frames=30):
    """Return runs with errors so many times as large as their covariance says, off by 1 mrad."""
    rng = np.random.default_rng(1)
    covariance = np.diag([1.0, 1.0, 100.0]) * ARCSEC ** 2
    sigma = np.sqrt(np.diag(covariance))
    error = 1e-3 + error_scale * sigma * rng.normal(size=(count, frames, 3))
    return Runs(error, np.tile(covariance, (count, frames, 1, 1)),
                np.tile(protection_sigma * sigma, (count, frames, 1)), np.zeros(count))


@pytest.mark.parametrize(('scale', 'protection_sigma', 'nees', 'wrong', 'misleading'), [
    (1.0, 6.0, 'met', 'met', 'met'), (0.5, 6.0, 'missed', 'met', 'met'),
    (1.3, np.inf, 'missed', 'met', 'met'), (4.0, 40.0, 'missed', 'missed', 'met'),
    (1.0, 2.0, 'met', 'met', 'missed')])
def test_a_covariance_or_a_protection_level_that_is_not_true_misses_its_goal(
        scale, protection_sigma, nees, wrong, misleading):
    table = list(consistency_rows([RunCase(0.3)], [runs(scale, protection_sigma)], 1e-3))
    found = {row.case: row for row in table}
    assert found['NEES, 0.3 deg/s'].ours == pytest.approx(3 * scale ** 2, rel=0.1)
    assert [row.goal.split(', ')[1] for row in table] == [nees, wrong, misleading]
    low, high = mean_chi_square_bounds(3, 40)
    assert found['NEES, 0.3 deg/s'].goal.startswith(f'{low:.2f} .. {high:.2f}')
    text = records(table)[0]['at rest'], records(table)[0]['0.3 deg/s']
    assert text[0] == '-' and text[1].endswith('missed)') == (nees == 'missed')


def test_without_an_attitude_nothing_is_said_of_its_consistency():
    none = Runs(*(np.full((2, 12, *shape), np.nan) for shape in ((3,), (3, 3), (3,))),
                np.full(2, np.inf))
    assert not list(consistency_rows([RunCase(0.0)], [none], np.zeros(3)))


def test_the_page_is_readable_on_phone_and_screen(page, sheet_and_result):
    assert_readable(page, sheet_and_result[0])


def test_a_figure_at_several_rates_is_one_line():
    table = [SheetRow('Error', 'noise, 0 deg/s, cross boresight', 2.0, 'arcsec', 6.0),
             SheetRow('Error', 'noise, 0.3 deg/s, cross boresight', 2.5, 'arcsec', 7.5),
             SheetRow('Error', 'noise, 0 deg/s, about boresight', 20.0, 'arcsec', 60.0),
             SheetRow('Speed', 'update rate', 1234.5, 'Hz')]
    assert records(table) == [
        {'figure': 'noise, cross boresight', 'unit': 'arcsec', 'at rest': '2',
         '0.3 deg/s': '2.5'},
        {'figure': 'noise, about boresight', 'unit': 'arcsec', 'at rest': '20', '0.3 deg/s': '-'},
        {'figure': 'update rate', 'unit': 'Hz', 'at rest': '1234', '0.3 deg/s': '-'}]
    assert rates_of(lines_of(table)) == [None, 0.0, 0.3]


@pytest.mark.parametrize(('text', 'words'), [
    ('psf: 1', 'psf is not an option of the detector'), ('[1, 2]', 'no options of the detector'),
    ('psf_sigma_px: 100', 'out of range'), ('{', 'no YAML'), ('exposure_s: no', 'must be float')])
def test_wrong_optics_are_named(tmp_path, text, words):
    file = tmp_path / 'optics.yaml'
    file.write_text(text)
    with pytest.raises(OpticsError, match=words):
        load_optics(file)
    result = invoke('datasheet', '--optics', str(file))
    assert result.exit_code == 2 and str(file) in result.stderr


def test_optics_change_what_they_name(tmp_path):
    file = tmp_path / 'optics.yaml'
    file.write_text('sky_simulator:\n  ros__parameters:\n    psf_sigma_px: 1.2\n')
    assert load_optics(file) == replace(DETECTOR, psf_sigma_px=1.2)


def test_the_formula_is_that_of_liebe_and_has_a_best_exposure():
    options = DesignOptions(rate_deg_s=2.0)
    magnitudes = field_magnitudes(design.camera_of(options), 9.0, 100, 1)
    expected = design.expectations(options, magnitudes)
    best = design.best_of(expected)
    assert expected[0].cross_rad > best.cross_rad <= expected[-1].cross_rad
    assert best.streak_px < expected[-1].streak_px
    # 40 stars of 0.1 px in a field of 12 deg over 1024 px.
    cross, about = design._liebe(CAMERA, 0.1, 40)
    assert cross / ARCSEC == pytest.approx(12 * 3600 * 0.1 / 1024 / 40 ** 0.5)
    assert about / ARCSEC == pytest.approx(0.1 / 0.3825 / 1024 / 40 ** 0.5 / ARCSEC, rel=1e-6)
    slower = design.best_of(design.expectations(replace(options, rate_deg_s=0.2), magnitudes))
    assert slower.exposure_s > best.exposure_s and slower.cross_rad < best.cross_rad


@pytest.mark.parametrize(('arguments', 'words'), [
    ('--qe 1.5', "'--qe': 1.5 is not in the range"),
    ('--focal-mm 1 --pixel-um 50', 'above 85 deg to one side'),
    ('--focal-mm 60 --f-number 60', 'fewer than 4 stars in the field'),
    ('--width 16384 --pixel-um 0.5 --rate-deg-s 20', 'stars already move by more than 30 px'),
    ('--width 16384 --f-number 0.5 --focal-mm 5000 --pixel-um 50 --qe 1 --transmission 1',
     'cannot be simulated')])
def test_an_impossible_design_is_named(arguments, words, monkeypatch):
    monkeypatch.setattr('startracker_ros.tools.datasheet.design._SKY_FIELDS', 20)
    result = invoke('design', *arguments.split())
    assert result.exit_code == 2, result.output
    assert words in ' '.join(result.stderr.split()), result.stderr


def test_the_picture_of_the_documents_is_of_the_result():
    docs = Path(__file__).parents[3] / 'docs'
    with Image.open(docs / 'pictures' / 'datasheet.png') as picture:
        text = picture.text['text']
    rows = json.loads((docs / 'results' / 'datasheet.json').read_text())['rows']
    for case in ('bias', 'field-of-view spatial error', 'pixel spatial error', 'temporal noise'):
        for axis in ('cross boresight', 'about boresight'):
            _, _, cells = text.partition(f'\n{case}, {axis}\tarcsec\t')
            ours = [row['ours'] for row in rows if row['case'].startswith(f'{case}, ')
                    and row['case'].endswith(axis)]
            # Three digits are shown; the last one differs between processors.
            assert [float(cell.split()[0]) for cell in cells.split('\t')[:len(ours)]] == (
                pytest.approx(ours, rel=0.01))

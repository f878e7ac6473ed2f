# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""False light, defects of the sensor and noise of its lines: each alone on the image."""

from dataclasses import replace

import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.sim.sky.artefacts import ArtefactOptions, draw_debris, draw_spots, draw_trails
from startracker_ros.sim.sky.charge import add_cosmic_rays, bloom
from startracker_ros.sim.sky.detector import Detector, DetectorOptions

CAMERA = Camera.from_fov(256, 192, 4.0)
EXACT = DetectorOptions(noise=False, background_e=0.0, bias_dn=0.0, gain_e_per_dn=0.25,
                        bit_depth=16, full_well_e=16000.0)
NO_STARS = np.zeros((0, 2)), np.zeros(0)


def image_of(artefacts=ArtefactOptions(), uv=NO_STARS[0], magnitude=NO_STARS[1],
             trails=np.zeros((0, 4)), seed=1, draws=1, **change):
    options = replace(EXACT, **change)
    detector = Detector(CAMERA, options, artefacts, seed=seed)
    rng = np.random.default_rng(draws)
    detector.expose(np.array(uv, float), np.array(magnitude), rng, trails=trails)
    return detector.read(rng) * options.gain_e_per_dn


@pytest.mark.parametrize('angle_deg', [0.0, 17.0, 45.0, 90.0, 138.0])
def test_a_trail_is_a_gaussian_across_and_even_along(angle_deg):
    angle = np.radians(angle_deg)
    trail = np.array([[120.3, 90.6, np.cos(angle), np.sin(angle)]])
    image = image_of(ArtefactOptions(trail_peak_e=3000.0, trail_sigma_px=1.5), trails=trail)
    v, u = np.indices(image.shape)
    distance = (v - 90.6) * np.cos(angle) - (u - 120.3) * np.sin(angle)
    variance = 1.5 ** 2 + 1 / 12
    expected = 3000 * 1.5 / np.sqrt(variance) * np.exp(-distance ** 2 / (2 * variance))
    np.testing.assert_allclose(image, expected, atol=0.3)
    # Across the whole image, the flux per pixel of length is that of the Gaussian.
    length_px = min(256 / max(abs(np.cos(angle)), 1e-9), 192 / max(abs(np.sin(angle)), 1e-9))
    flux = 3000 * 1.5 * np.sqrt(2 * np.pi)
    assert image.sum() / flux > 0.6 * length_px


def test_debris_drifts_together_and_has_its_own_width():
    options = ArtefactOptions(debris=40, debris_sigma_px=3.0, debris_drift_px_s=(20.0, -10.0))
    first, later = (draw_debris(CAMERA, options, np.random.default_rng(5), time_s)
                    for time_s in (0.0, 1.5))
    np.testing.assert_array_equal(first[1], later[1])
    moved = (later[0] - first[0]) % [CAMERA.width, CAMERA.height]
    np.testing.assert_allclose(moved, np.tile([30.0, CAMERA.height - 15.0], (40, 1)))
    assert CAMERA.contains(later[0]).all()
    detector, rng = Detector(CAMERA, EXACT, options, seed=1), np.random.default_rng(1)
    detector.expose(*NO_STARS, rng, debris=(np.array([[100.0, 80.0]]), np.array([4.0])))
    image = detector.read(rng) * EXACT.gain_e_per_dn
    u = np.arange(CAMERA.width)
    assert image.sum() == pytest.approx(detector.flux_e(4.0), rel=0.01)
    assert (image * (u - 100) ** 2).sum() / image.sum() == pytest.approx(9 + 1 / 12, rel=0.02)


def test_trails_are_random_but_those_of_their_generator():
    options, rng = ArtefactOptions(trails=100), np.random.default_rng(3)
    trails = np.vstack([draw_trails(CAMERA, options, rng) for _ in range(20)])
    assert CAMERA.contains(trails[:, :2]).all()
    assert np.hypot(trails[:, 2], trails[:, 3]) == pytest.approx(1.0)
    angle = np.degrees(np.arctan2(trails[:, 3], trails[:, 2]))
    assert np.histogram(angle, 6, (0, 180))[0] == pytest.approx(2000 / 6, abs=80)
    again = draw_trails(CAMERA, options, np.random.default_rng(3))
    np.testing.assert_array_equal(trails[:100], again)


def test_spots_have_the_magnitudes_of_their_range():
    options = ArtefactOptions(star_like_spots=3000, star_like_spot_magnitudes=(2.0, 6.0))
    spots = draw_spots(CAMERA, options, np.random.default_rng(3))
    assert len(spots) == 3000 and not spots.hip.any()
    assert CAMERA.contains(spots.uv).all()
    assert spots.magnitude.min() > 2 and spots.magnitude.max() < 6
    assert spots.magnitude.mean() == pytest.approx(4.0, abs=0.1)


def test_blooming_conserves_charge_along_the_column():
    rng = np.random.default_rng(2)
    light = rng.uniform(0, 500, (200, 30)).astype(np.float32)
    light[100, 10] = 40_000
    light[95:105, 20] = 7_000
    before = light.sum(0, dtype=float)
    bloom(light, 1000.0)
    limited = np.minimum(light, 1000)
    np.testing.assert_allclose(limited.sum(0, dtype=float), before, rtol=1e-5)
    full = np.flatnonzero(limited[:, 10] == 1000)
    assert np.ptp(full) == len(full) - 1 > 40, 'one streak'
    # The charge flows evenly; where it ends depends on what was in the pixels.
    assert full[[0, -1]].mean() == pytest.approx(100, abs=4)
    untouched = np.delete(np.arange(30), [10, 20])
    np.testing.assert_allclose(limited[:, untouched].sum(0, dtype=float), before[untouched])


def test_a_bright_star_blooms_along_its_column_only_if_asked():
    star = {'uv': [(100.0, 90.0)], 'magnitude': [-2.0], 'full_well_e': 10000.0}
    plain, bloomed = image_of(**star), image_of(**star, blooming=True)
    full = np.argwhere(bloomed == 10000)
    assert np.ptp(full[:, 0]) > 3 * np.ptp(full[:, 1])
    assert bloomed.sum() == pytest.approx(1.262e6, rel=2e-3)
    assert plain.sum() < 0.5 * bloomed.sum()
    noisy = image_of(**star, blooming=True, noise=True, read_noise_e=0.1)
    assert np.ptp(noisy[bloomed == 10000]) < 1.0, 'a full pixel has no photon noise'


def test_saturated_lines_spill_into_their_neighbours():
    image = image_of(ArtefactOptions(saturated_columns=1), full_well_e=10000.0)
    [column] = np.flatnonzero((image == 10000).all(0))
    full_e = 10000 + 8 * 100
    for distance in (1, 2, 4):
        near = image[:, [c for c in (column - distance, column + distance) if 0 <= c < 256]]
        assert near == pytest.approx(full_e * 0.3 ** distance, abs=0.3)
    assert not np.delete(image, np.arange(column - 4, column + 5), 1).any()
    rows = image_of(ArtefactOptions(saturated_rows=2), full_well_e=10000.0)
    assert np.count_nonzero((rows == 10000).all(1)) == 2


def test_defects_stay_for_a_seed_and_have_their_levels():
    artefacts = ArtefactOptions(warm_columns=5, warm_column_dn=30.0, dead_columns=3, dead_rows=2)
    change = {'background_e': 1000.0, 'gain_e_per_dn': 2.0, 'bit_depth': 12}
    image = image_of(artefacts, **change)
    dead_rows = np.flatnonzero((image <= 60).all(1))
    assert len(dead_rows) == 2
    live = np.delete(image, dead_rows, 0)
    assert np.count_nonzero((live == 0).all(0)) == 3
    assert np.count_nonzero((live == 1060).all(0)) == 5
    assert np.count_nonzero((live == 1000).all(0)) == 248
    np.testing.assert_array_equal(image_of(artefacts, draws=2, **change), image)
    assert (image_of(artefacts, seed=2, **change) != image).any()


def test_row_noise_and_column_pattern_have_their_standard_deviations():
    change = {'background_e': 1000.0, 'gain_e_per_dn': 1.0, 'bias_dn': 200.0,
              'full_well_e': 5000.0, 'bit_depth': 12}
    rows = image_of(row_noise_dn=9.0, **change)
    assert (rows == rows[:, :1]).all()
    assert rows[:, 0].std() == pytest.approx(9.0, rel=4 / np.sqrt(2 * 192))
    other = image_of(row_noise_dn=9.0, draws=2, **change)
    assert abs(np.corrcoef(rows[:, 0], other[:, 0])[0, 1]) < 0.3
    columns = image_of(column_pattern_dn=9.0, **change)
    assert (columns == columns[:1]).all()
    assert columns[0].std() == pytest.approx(9.0, rel=4 / np.sqrt(2 * 256))
    np.testing.assert_array_equal(image_of(column_pattern_dn=9.0, draws=2, **change), columns)


def test_row_noise_adds_to_the_other_noise():
    change = {'background_e': 400.0, 'gain_e_per_dn': 1.0, 'bias_dn': 200.0, 'noise': True,
              'bit_depth': 12}
    quiet, rows = image_of(**change), image_of(row_noise_dn=0.4, **change)
    assert np.abs(rows - quiet).max() <= 2, 'the same photons'
    assert (rows - quiet).mean(1).std() == pytest.approx(0.4, rel=0.25)


def test_the_moon_is_a_disc_of_its_radius_and_hides_stars():
    artefacts = ArtefactOptions(moon_e=5000.0, moon_radius_deg=0.4, moon_distance_deg=1.0,
                                moon_angle_deg=30.0, moon_softness_deg=0.001)
    image = image_of(artefacts)
    lit = image > 2500
    radius_px = np.radians(0.4) / CAMERA.pixel_rad
    assert lit.sum() == pytest.approx(np.pi * radius_px ** 2, rel=0.01)
    assert image[lit].mean() == pytest.approx(5000.0, rel=0.01)
    v, u = np.nonzero(lit)
    offset_px = np.array([u.mean() - CAMERA.cx, v.mean() - CAMERA.cy])
    assert np.degrees(np.arctan2(*offset_px[::-1])) == pytest.approx(30.0, abs=0.3)
    assert np.hypot(*offset_px) == pytest.approx(np.tan(np.radians(1)) * CAMERA.fx, abs=0.3)
    centre = np.array([[u.mean(), v.mean()], [20.0, 20.0], [255.5, 191.5]])
    detector = Detector(CAMERA, EXACT, artefacts)
    np.testing.assert_array_equal(detector.visible(centre), [False, True, True])
    hidden = image_of(artefacts, uv=centre[:1], magnitude=[3.0])
    np.testing.assert_allclose(hidden, image, atol=0.3)


def test_the_limb_of_the_earth_is_an_arc_that_fades_outwards():
    artefacts = ArtefactOptions(earth_e=8000.0, earth_radius_deg=64.0, earth_distance_deg=64.5,
                                earth_angle_deg=90.0, earth_softness_deg=0.1)
    image = image_of(artefacts)
    # Half of the brightness at the radius: half a degree below the boresight.
    row = CAMERA.cy + np.tan(np.radians(0.5)) * CAMERA.fy
    column = image[:, 128]
    assert np.interp(4000, column, np.arange(192)) == pytest.approx(row, abs=0.1)
    assert (np.diff(column) >= 0).all() and column[-1] > 7900
    # Beside the middle the arc is lower.
    assert np.interp(4000, image[:, 0], np.arange(192)) > row + 0.5


def test_the_number_of_hits_is_poisson():
    light = np.zeros((1024, 1024), np.float32)
    hits = [add_cosmic_rays(light, 1e4, 5.5, np.random.default_rng(seed)) for seed in range(200)]
    assert np.mean(hits) == pytest.approx(1e4, abs=4 * np.sqrt(1e4 / 200))
    assert np.var(hits) == pytest.approx(1e4, rel=4 * np.sqrt(2 / 200))


def test_the_detector_counts_its_hits():
    detector = Detector(CAMERA, replace(EXACT, cosmic_ray_hits_cm2_s=1e5))
    mean = 1e5 * 0.1 * 256 * 192 * 5.5e-4 ** 2
    rng = np.random.default_rng(4)
    hits = [detector.expose(*NO_STARS, rng) for _ in range(300)]
    assert np.mean(hits) == pytest.approx(mean, abs=4 * np.sqrt(mean / 300))

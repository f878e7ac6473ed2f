# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a real sensor adds: each effect alone, measured on the rendered image."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, poisson
from skies import CAMERA as FULL_CAMERA
from startracker_ros.core.camera.model import Camera
from startracker_ros.sim.sky.charge import add_cosmic_rays, DEPTH_UM
from startracker_ros.sim.sky.detector import Detector, DetectorOptions
from startracker_ros.sim.sky.psf import add_starlight

CAMERA = Camera.from_fov(256, 192, 4.0)
EXACT = DetectorOptions(noise=False, background_e=0.0, bias_dn=0.0, gain_e_per_dn=0.25,
                        bit_depth=16, full_well_e=16000.0)
NOBODY = np.zeros((0, 2)), np.zeros(0)


def image_of(change, uv=NOBODY[0], magnitude=NOBODY[1], seed=1, base=EXACT, draws=1):
    detector = Detector(CAMERA, replace(base, **change), seed=seed)
    return detector.render(np.array(uv, float), np.array(magnitude), np.random.default_rng(draws)
                           ) * (replace(base, **change).gain_e_per_dn)


def second_moment(image, u, v, half=14):
    window = image[v - half:v + half + 1, u - half:u + half + 1]
    grid = np.arange(-half, half + 1)
    across = window.sum(0) / window.sum()
    return across @ grid ** 2 - (across @ grid) ** 2


def test_star_images_widen_towards_the_corner():
    """A pixel adds 1/12 to the variance; half way to the corner a quarter of the growth."""
    change = {'psf_sigma_px': 0.8, 'psf_corner_sigma_px': 2.0}
    centre = np.array([127.5, 95.5])
    uv = np.round([centre + 0.001, centre * 1.5 + 0.001, centre * 1.84])
    image = image_of(change, uv, [3.0, 3.0, 3.0])
    for pixel in uv.astype(int):
        distance2 = ((pixel - centre) ** 2).sum() / (128 ** 2 + 96 ** 2)
        sigma = 0.8 + 1.2 * distance2
        assert second_moment(image, *pixel) == pytest.approx(sigma ** 2 + 1 / 12, rel=4e-3)
    plain = image_of({'psf_sigma_px': 0.8}, uv, [3.0, 3.0, 3.0])
    assert second_moment(plain, *uv[2].astype(int)) == pytest.approx(0.64 + 1 / 12, rel=4e-3)
    assert image.sum() == pytest.approx(plain.sum(), rel=1e-3)


def test_dark_current_fills_with_time():
    for exposure_s in (0.1, 0.5):
        image = image_of({'dark_current_e_s': 400.0, 'exposure_s': exposure_s})
        assert image == pytest.approx(400.0 * exposure_s)
    noisy = image_of({'dark_current_e_s': 400.0, 'noise': True, 'bias_dn': 400.0,
                      'read_noise_e': 0.1})
    assert noisy.mean() == pytest.approx(140.0, abs=5 * np.sqrt(40 / noisy.size))
    assert noisy.var() == pytest.approx(40.0, rel=5 * np.sqrt(2 / noisy.size))


def test_hot_pixels_stay_for_a_seed():
    change = {'hot_pixel_fraction': 0.01, 'hot_pixel_e_s': 5000.0}
    image = image_of(change)
    hot = image[image > 0]
    assert poisson.cdf(hot.size, image.size * 0.01) > 1e-3
    assert poisson.sf(hot.size, image.size * 0.01) > 1e-3
    assert kstest(hot, 'expon', args=(0, 500.0)).pvalue > 1e-3
    np.testing.assert_array_equal(image_of(change, draws=2), image)
    other = image_of(change, seed=2)
    assert ((other > 0) & (image > 0)).sum() < 0.1 * hot.size


def test_flat_field_scales_all_light_but_not_dark_current():
    change = {'flat_field_percent': 2.0, 'background_e': 1000.0}
    flat = image_of(change)
    assert flat.mean() == pytest.approx(1000.0, abs=0.5)
    assert flat.std() == pytest.approx(20.0, rel=0.02)
    response = flat / 1000
    star = image_of({'flat_field_percent': 2.0}, [(100.3, 90.2)], [4.0])
    plain = image_of({}, [(100.3, 90.2)], [4.0])
    np.testing.assert_allclose(star, plain * response, atol=0.3, rtol=3e-4)
    glow = {'stray_light_e': 500.0}
    np.testing.assert_allclose(image_of(glow | {'flat_field_percent': 2.0}),
                               image_of(glow) * response, atol=0.3, rtol=3e-4)
    dark = image_of({'flat_field_percent': 2.0, 'dark_current_e_s': 5000.0})
    assert dark == pytest.approx(500.0)


@pytest.mark.parametrize('angle_deg, corner', [
    (0.0, None), (-90.0, None), (45.0, (-1, -1)), (-135.0, (0, 0)), (200.0, (0, 0))])
def test_stray_light_comes_from_its_side(angle_deg, corner):
    image = image_of({'stray_light_e': 2000.0, 'stray_light_angle_deg': angle_deg,
                      'stray_light_falloff_deg': 1.5})
    assert image.max() == pytest.approx(2000.0, abs=0.3)
    # Without noise the glow is a plane in logarithm: its gradient tells angle and fall-off.
    inner = np.log(image[10:-10, 10:-10])
    v, u = np.gradient(inner)
    assert np.degrees(np.arctan2(v.mean(), u.mean())) % 360 == pytest.approx(
        angle_deg % 360, abs=0.2)
    e_fold_deg = np.degrees(CAMERA.pixel_rad / np.hypot(u.mean(), v.mean()))
    assert e_fold_deg == pytest.approx(1.5, rel=3e-3)
    if corner is not None:
        assert image[corner] == image.max()


def test_stray_light_has_its_own_photon_noise():
    change = {'stray_light_e': 900.0, 'stray_light_falloff_deg': 1000.0, 'noise': True,
              'read_noise_e': 1.0, 'bias_dn': 100.0}
    image = image_of(change)
    assert image.var() == pytest.approx(image.mean() - 25 + 1, rel=0.03)


def tracks(hits, seed, pitch_um=5.5):
    light = np.zeros((256, 256), np.float32)
    add_cosmic_rays(light, hits, pitch_um, np.random.default_rng(seed))
    return light


def test_number_of_cosmic_rays():
    """5 hits/cm^2/s: over 0.32 cm^2 in 0.2 s it is 0.32 a frame."""
    detector = Detector(FULL_CAMERA, replace(EXACT, cosmic_ray_hits_cm2_s=5.0, exposure_s=0.2))
    mean = 5 * (1024 * 5.5e-4) ** 2 * 0.2
    rng = np.random.default_rng(3)
    struck = [detector.render(*NOBODY, rng).any() for _ in range(300)]
    share = 1 - np.exp(-mean)
    assert np.mean(struck) == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 300))


def test_cosmic_rays_leave_the_charge_of_their_path():
    """
    Half of an isotropic flux comes in steeper than 45 deg.

    So the median track is as long as the silicon is deep. The median of the Moyal distribution
    lies 0.788 above its mode.
    """
    length_um, e_per_um = [], []
    for seed in range(3000):
        light = tracks(0.1, seed, pitch_um=0.5)
        row, column = np.nonzero(light)
        if len(row) and min(row.min(), column.min()) > 0 and max(row.max(), column.max()) < 255:
            flat_um = 0.5 * np.hypot(np.ptp(row), np.ptp(column))
            length_um.append(flat_um)
            e_per_um.append(light.sum() / np.hypot(DEPTH_UM, flat_um))
    assert len(length_um) > 200
    assert np.median(length_um) == pytest.approx(DEPTH_UM, rel=0.15)
    assert np.median(e_per_um) == pytest.approx(77.9, rel=0.04)


def test_cosmic_rays_come_anew_in_every_frame():
    assert not ((tracks(30.0, 1) > 0) & (tracks(30.0, 2) > 0)).any()
    np.testing.assert_array_equal(tracks(30.0, 1), tracks(30.0, 1))


def test_impossible_sources_leave_no_light():
    light, response = np.zeros((40, 60), np.float32), np.ones((40, 60), np.float32)
    uv = np.array([[np.nan, 5.0], [5.0, np.inf], [1e12, 5.0], [5.0, -1e12], [30.0, 20.0]])
    add_starlight(uv, np.full(5, 1e3), np.array([1.0, 1.0, 1.0, 1.0, 1e3]), response, light)
    assert not light.any()
    add_starlight(uv[4:], np.array([1e3]), np.array([1.0]), response, light)
    assert light.sum() == pytest.approx(1e3, rel=1e-5)

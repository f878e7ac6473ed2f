# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of cameras with hot pixels: dark frames, lists of bad pixels, and neither."""

from astropy.io import fits
import cv2
import numpy as np
import pytest
import startracker_ros as st
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.io.images.dark import read_dark
from startracker_ros.io.images.images import ImageError, Photograph, read_image
from startracker_ros.photographs.hot_clusters import without_clusters
from startracker_ros.photographs.solve import solve_files

YEAR = 2019.57


@pytest.fixture(scope='module')
def image(sky_data):
    return read_image(sorted((sky_data / 'night-sky-11deg').glob('*.png'))[2])


def dark_frame(shape, count, seed, size=1):
    """Return hot pixels (H, W), in squares of size px, as bright as stars."""
    rng, dark = np.random.default_rng(seed), np.zeros(shape, np.uint16)
    for v, u in rng.integers(3, np.array(shape) - 4, (count, 2)):
        dark[v:v + size, u:u + size] = rng.uniform(8000, 50000) * rng.uniform(0.9, 1, (size, size))
    return dark


@pytest.mark.slow
def test_a_dark_frame_and_a_list_of_its_pixels_are_the_same(image, tmp_path):
    """Squares of 3 px, so many that a short search does not find the stars among them."""
    dark = dark_frame(image.shape, 400, 1, size=3)
    light = np.minimum(image.astype(int) + dark, 65535).astype(np.uint16)
    cv2.imwrite(str(tmp_path / 'light.png'), light)
    # As a camera writes them, and scaled: the values of the file count, not those of the image.
    cv2.imwrite(str(tmp_path / 'dark.png'), dark)
    fits.PrimaryHDU(dark.astype(np.float32)[::-1]).writeto(tmp_path / 'dark.fits')
    v, u = np.nonzero(dark)
    lines = '\n'.join(f'{x},{y}' for x, y in zip(u, v))
    (tmp_path / 'bad.txt').write_text(f'# u, v of the upright image\n\n{lines} # the last one\n')
    none, = solve_files([tmp_path / 'light.png'], fov_deg=11.4, epoch_year=YEAR,
                        options=IdentificationOptions(time_limit_s=0.2)).rows
    assert not none['solved'] and 'dark frame' in none['reason']
    truth = st.solve(image, 11.4, YEAR)
    for one in (tmp_path / 'dark.png', tmp_path / 'dark.fits', tmp_path / 'bad.txt', dark):
        solution = st.solve(light, 11.4, YEAR, dark=one)
        assert solution.matched >= truth.matched - 6, one
        assert solution.ra_deg == pytest.approx(truth.ra_deg, abs=2e-3)
    row, = solve_files([tmp_path / 'light.png'], fov_deg=11.4, epoch_year=YEAR,
                       dark_file=tmp_path / 'bad.txt').rows
    assert row['solved']


@pytest.mark.parametrize('content, words', [
    ('', 'no pixels in it'), ('3,4\n5;6\n', "line 2: '5;6' is not a u,v of a pixel"),
    ('3 4 5', 'line 1'), ('9999, 4', '9999,4 is not in the image of 1024 x 768 px'),
    ('-1, 4', '-1,4 is not in the image')])
def test_wrong_lists_are_named(image, tmp_path, content, words):
    (tmp_path / 'bad.csv').write_text(content)
    with pytest.raises(ImageError, match=words):
        read_dark(tmp_path / 'bad.csv').subtracted(Photograph(image))


def test_wrong_dark_frames_are_named(image, tmp_path):
    with pytest.raises(ImageError, match='100 x 90 px, the image has 1024 x 768'):
        st.solve(image, 11.4, dark=np.zeros((90, 100), np.uint16))
    cv2.imwrite(str(tmp_path / 'small.png'), np.eye(90, dtype=np.uint8))
    cv2.imwrite(str(tmp_path / 'light.png'), image)
    row, = solve_files([tmp_path / 'light.png'], dark_file=tmp_path / 'small.png').rows
    assert 'small.png: 90 x 90 px' in row['reason'] and not row['solved']
    with pytest.raises(ImageError, match='no.png'):
        solve_files([tmp_path / 'light.png'], dark_file=tmp_path / 'no.png')


@pytest.mark.slow
@pytest.mark.parametrize('count', [150, 500])
def test_snow_of_hot_pixels_is_not_sky_and_hides_none(image, count):
    snow = dark_frame(image.shape, count, count, size=2)
    for given_deg in (11.4, None):
        solution = st.solve(np.maximum(image, snow), given_deg, YEAR)
        assert solution.solved, solution.reason
        assert solution.fov_deg == pytest.approx(11.42, abs=0.02)
    clean = without_clusters(np.maximum(image, snow))
    assert np.mean(clean[snow > 0] > 6000) < 0.1


@pytest.mark.parametrize('sigma_px', [0.5, 0.6, 1.0, 2.0])
def test_stars_are_not_clusters_of_hot_pixels(sigma_px):
    rng = np.random.default_rng(2)
    v, u = np.mgrid[:400, :400]
    sky = rng.normal(200, 4, (400, 400))
    for x, y in rng.uniform(10, 390, (60, 2)):
        near = np.s_[int(y) - 9:int(y) + 10, int(x) - 9:int(x) + 10]
        spread = ((u[near] - x) ** 2 + (v[near] - y) ** 2) / (2 * max(sigma_px, 0.5) ** 2)
        sky[near] += 10 ** rng.uniform(3, 4.5) * np.exp(-spread) / sigma_px ** 2
    stars = sky.clip(0, 65535).astype(np.uint16)
    assert without_clusters(stars) is stars

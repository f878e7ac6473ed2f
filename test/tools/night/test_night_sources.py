# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of folders and videos with their stamps."""

from itertools import pairwise

from astropy.io import fits
import numpy as np
from PIL import Image
import pytest
from startracker_ros.core.astro.epoch import stamp_from_epoch_year, utc
from startracker_ros.tools.night.sources import is_bag, NightError, timed_images

PIXELS = np.arange(64 * 64, dtype=np.uint16).reshape(64, 64)
TIMES = ('2026-11-23T23:59:58.250', '2026-11-24T00:00:03.500', '2026-11-24T00:00:09.125')


@pytest.fixture
def dated(tmp_path):
    """Return a folder of FITS files with DATE-OBS."""
    for number, time in enumerate(TIMES):
        header = fits.Header([('DATE-OBS', time)])
        fits.PrimaryHDU(PIXELS + number, header).writeto(tmp_path / f'{number}.fits')
    return tmp_path


def stamps(source, start_year=None, interval_s=None):
    return [each.stamp_ns for each in timed_images(source, start_year, interval_s, None)]


def test_files_have_their_own_times(dated):
    assert [utc(stamp) for stamp in stamps(dated)] == [*TIMES]


def test_a_given_start_moves_all_and_an_interval_replaces_their_steps(dated):
    moved = stamps(dated, 2026.0)
    assert moved[0] == stamp_from_epoch_year(2026.0)
    assert np.diff(moved).tolist() == np.diff(stamps(dated)).tolist()
    even = stamps(dated, None, 2.5)
    assert utc(even[0]) == TIMES[0]
    assert [after - before for before, after in pairwise(even)] == [2_500_000_000] * 2


def test_the_place_of_the_zenith_needs_a_time_zone(dated, tmp_path_factory):
    assert len([*timed_images(dated, None, None, None, zone_needed=True)]) == 3
    local = tmp_path_factory.mktemp('local') / 'a.jpg'
    exif = Image.Exif()
    exif[0x8769] = {0x9003: '2026:11:23 23:00:00'}
    Image.fromarray(PIXELS.astype(np.uint8)).save(local, exif=exif)
    assert len(stamps(local.parent)) == 1
    with pytest.raises(NightError, match='no time zone'):
        next(timed_images(local.parent, None, None, None, zone_needed=True))
    next(timed_images(local.parent, 2026.5, None, None, zone_needed=True))


def test_a_file_without_a_time_is_named(dated):
    fits.PrimaryHDU(PIXELS).writeto(dated / '3.fits')
    with pytest.raises(NightError, match=r'3\.fits: no time in it, --interval-s'):
        stamps(dated)


def test_a_file_that_cannot_be_read_is_left_out(dated):
    whole, left_out = stamps(dated), []
    even = stamps(dated, None, 2.5)
    (dated / '0.fits').write_bytes(b'nothing')
    found = [each.stamp_ns for each in timed_images(dated, None, None, None, left_out=left_out)]
    assert found == whole[1:] and len(left_out) == 1 and '0.fits' in left_out[0]
    assert np.diff(stamps(dated, None, 2.5)).tolist() == np.diff(even[1:]).tolist()
    for name in '12':
        (dated / f'{name}.fits').write_bytes(b'nothing')
    with pytest.raises(NightError, match='0.fits'):
        stamps(dated)


def test_frames_of_a_video_follow_from_the_start(tmp_path):
    path = tmp_path / 'night.tiff'
    pages = [Image.fromarray(PIXELS + number) for number in range(3)]
    pages[0].save(path, save_all=True, append_images=pages[1:])
    with pytest.raises(NightError, match='--epoch'):
        stamps(path, None, 4.0)
    begin_ns = stamp_from_epoch_year(2026.5)
    assert stamps(path, 2026.5, 4.0) == [begin_ns + 4_000_000_000 * number for number in range(3)]


def test_images_are_not_a_bag(dated):
    assert not is_bag(dated) and not is_bag(dated / '0.fits')
    (dated / 'metadata.yaml').write_text('')
    assert is_bag(dated) and is_bag(dated / 'x.mcap')

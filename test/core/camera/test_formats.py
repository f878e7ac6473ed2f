# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""FITS, XISF, SER, TIFF and camera RAW: number types, orientation, files of no use."""

import gzip
import io
import struct
import sys
import zlib

from astropy.io import fits
import cv2
import lz4.block
import numpy as np
import pytest
from startracker_ros.core.camera.levels import sixteen_bit
from startracker_ros.core.extras import install_hint
from startracker_ros.io.images.images import image_paths, ImageError, read_image, read_photograph
from startracker_ros.io.images.video import frames, is_video
import zstandard

SKY = np.random.default_rng(3).normal(900, 5, (40, 60))
SKY[7, 11] += 20000


def scaled(values):
    """Return values as a share of their range."""
    return (values - values.min()) / np.ptp(values)


@pytest.mark.parametrize('dtype', ['uint8', 'uint16', 'int16', 'int32', 'float32', 'float64'])
def test_fits_of_every_number_type(tmp_path, dtype):
    sky = (SKY / 100 if dtype == 'uint8' else SKY).astype(dtype)
    fits.PrimaryHDU(sky).writeto(tmp_path / 'a.fits')
    image = read_image(tmp_path / 'a.fits')
    assert image.dtype == (np.uint8 if dtype == 'uint8' else np.uint16) and image.dtype.isnative
    # The first row of the file is the lowest one.
    np.testing.assert_allclose(scaled(image.astype(float)), scaled(sky[::-1].astype(float)),
                               atol=2e-3)
    assert np.unravel_index(image.argmax(), image.shape) == (32, 11)


def test_rows_from_the_top(tmp_path):
    header = fits.Header([('ROWORDER', 'TOP-DOWN')])
    fits.PrimaryHDU(SKY.astype(np.uint16), header).writeto(tmp_path / 'a.fits')
    photograph = read_photograph(tmp_path / 'a.fits')
    np.testing.assert_array_equal(photograph.image, SKY.astype(np.uint16))
    assert not photograph.bottom_up


def test_compressed_images_and_extensions(tmp_path):
    empty, table = fits.PrimaryHDU(), fits.BinTableHDU.from_columns(
        [fits.Column('a', 'J', array=np.arange(3))])
    fits.HDUList([empty, table, fits.CompImageHDU(SKY.astype(np.int16)[None])]).writeto(
        tmp_path / 'a.fits')
    assert (read_image(tmp_path / 'a.fits')[32, 11] - int(np.median(SKY))) > 15000


@pytest.mark.parametrize('cube', [
    np.stack([SKY, SKY - 300, SKY + 300]), np.stack([SKY, SKY - 300, SKY + 300], -1),
    np.stack([SKY, SKY[::-1]]), np.stack([[SKY] * 4])])
def test_a_cube_is_the_mean_of_colours_or_its_first_plane(tmp_path, cube):
    fits.PrimaryHDU(cube.astype(np.float32)).writeto(tmp_path / 'a.fits')
    fits.PrimaryHDU(SKY.astype(np.float32)).writeto(tmp_path / 'b.fits')
    np.testing.assert_allclose(scaled(read_image(tmp_path / 'a.fits').astype(float)),
                               scaled(read_image(tmp_path / 'b.fits').astype(float)), atol=1e-3)


def test_a_file_compressed_by_gzip_is_read_and_found_in_a_folder(tmp_path):
    fits.PrimaryHDU(SKY.astype(np.uint16)).writeto(tmp_path / 'a.fits')
    content = gzip.compress((tmp_path / 'a.fits').read_bytes())
    (tmp_path / 'a.fits.gz').write_bytes(content)
    (tmp_path / 'b.fits.gz').write_bytes(content[:len(content) // 2])
    (tmp_path / 'c.fits.gz').write_bytes(content[:10] + b'\xff' * 99)
    np.testing.assert_array_equal(read_image(tmp_path / 'a.fits.gz'),
                                  read_image(tmp_path / 'a.fits'))
    # As in files of one observatory.
    (tmp_path / 'a.fits.gz').write_bytes(content[:-4] + b'odd!')
    np.testing.assert_array_equal(read_image(tmp_path / 'a.fits.gz'),
                                  read_image(tmp_path / 'a.fits'))
    assert [path.name for path in image_paths([tmp_path])] == [
        'a.fits', 'a.fits.gz', 'b.fits.gz', 'c.fits.gz']
    for name in 'bc':
        with pytest.raises(ImageError, match=f'{name}.fits.gz: '):
            read_image(tmp_path / f'{name}.fits.gz')


@pytest.mark.parametrize('units, words', [
    ([fits.PrimaryHDU(np.zeros(9, np.uint8))], 'an array of 9'),
    ([fits.PrimaryHDU()], 'empty'),
    ([fits.PrimaryHDU(), fits.BinTableHDU.from_columns(
        [fits.Column('a', 'J', array=np.arange(3))])], 'a table'),
    ([fits.PrimaryHDU(np.full((8, 9), np.nan, np.float32))], 'no finite pixel')])
def test_fits_that_is_not_an_image(tmp_path, units, words):
    fits.HDUList(units).writeto(tmp_path / 'a.fits')
    with pytest.raises(ImageError, match=f'a.fits: .*{words}'):
        read_image(tmp_path / 'a.fits')


@pytest.mark.parametrize('length', [30, 700, 2880, 6000])
def test_truncated_fits_is_named(tmp_path, length):
    file = io.BytesIO()
    fits.PrimaryHDU(SKY.astype(np.float32)).writeto(file)
    (tmp_path / 'a.fits').write_bytes(file.getvalue()[:length])
    with pytest.raises(ImageError, match='a.fits'):
        read_image(tmp_path / 'a.fits')


def test_a_huge_fits_is_named_before_it_is_read(tmp_path):
    header = fits.PrimaryHDU(np.zeros((2, 2), np.uint8)).header
    header['NAXIS1'] = header['NAXIS2'] = 30000
    (tmp_path / 'a.fits').write_bytes(header.tostring().encode() + bytes(2880))
    with pytest.raises(ImageError, match='30000 x 30000 px'):
        read_image(tmp_path / 'a.fits')


def test_the_header_has_time_and_field_of_view(tmp_path):
    header = fits.Header([('DATE-OBS', '2019-07-29T20:47:26.5'), ('FOCALLEN', 200.0),
                          ('XPIXSZ', 4.0)])
    fits.PrimaryHDU(SKY.astype(np.uint16), header).writeto(tmp_path / 'a.fits')
    photograph = read_photograph(tmp_path / 'a.fits')
    assert photograph.taken == (1564433246_500000000, True, 'DATE-OBS')
    # 0.07 deg: no camera.
    assert photograph.fov_deg is None
    fits.setval(tmp_path / 'a.fits', 'XPIXSZ', value=400.0)
    fits.setval(tmp_path / 'a.fits', 'DATE-OBS', value='2019-07-29')
    photograph = read_photograph(tmp_path / 'a.fits')
    assert photograph.fov_deg == pytest.approx(np.degrees(2 * np.arctan(12 / 200)))
    assert photograph.taken == (1564358400 * 10 ** 9, False, 'DATE-OBS')


@pytest.mark.parametrize('cards, taken', [
    ({'DATE-OBS': '29/07/98'}, ('1998-07-29T00:00:00', False, 'DATE-OBS')),
    ({'DATE-OBS': '2016-12-31T23:59:60'}, ('2017-01-01T00:00:00', True, 'DATE-OBS')),
    ({'DATE-OBS': '2016-12-31T23:59:60.5'}, ('2017-01-01T00:00:00.5', True, 'DATE-OBS')),
    ({'MJD-OBS': 58693.75}, ('2019-07-29T18:00:00', True, 'MJD-OBS')),
    ({'DATE-OBS': 'noon', 'MJD-OBS': 58693.75}, ('2019-07-29T18:00:00', True, 'MJD-OBS')),
    ({'MJD-OBS': 'noon'}, None), ({'DATE-OBS': '31/02/98'}, None)])
def test_times_of_headers(tmp_path, cards, taken):
    fits.PrimaryHDU(SKY.astype(np.uint16), fits.Header(cards.items())).writeto(
        tmp_path / 'a.fits')
    found = read_photograph(tmp_path / 'a.fits').taken
    if taken is None:
        assert found is None
        return
    stamp = np.datetime64(taken[0], 'ns').astype(int)
    assert found == (stamp, *taken[1:])


def test_an_image_behind_an_empty_one_is_read(tmp_path):
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(np.zeros(SKY.shape, np.uint8)),
                  fits.ImageHDU(SKY.astype(np.uint16))]).writeto(tmp_path / 'a.fits')
    np.testing.assert_array_equal(read_image(tmp_path / 'a.fits')[::-1], SKY.astype(np.uint16))


@pytest.mark.parametrize('scale', [1.0, 65535.0])
def test_tiff_of_floats_is_read(tmp_path, scale):
    values = (SKY / SKY.max() / scale).astype(np.float32)
    cv2.imwrite(str(tmp_path / 'a.tiff'), values)
    cv2.imwrite(str(tmp_path / 'b.tiff'), np.repeat(values[..., None], 3, axis=2))
    for name in 'ab':
        photograph = read_photograph(tmp_path / f'{name}.tiff')
        image = photograph.image.astype(float)
        inside = (image > 0) & (image < image.max())
        assert inside.mean() > 0.8
        slope = np.polyfit(values[inside], image[inside], 1)[0]
        assert slope * photograph.step == pytest.approx(1, rel=0.01)
    cv2.imwrite(str(tmp_path / 'c.tiff'), np.full((20, 30), np.nan, np.float32))
    with pytest.raises(ImageError, match='c.tiff: no finite pixel'):
        read_image(tmp_path / 'c.tiff')


SER_TICKS = 636_999_300_000_000_000
"""2019-07-29 14:20 UTC in 100 ns from the year 1."""


def ser(images, colour=0, order='<', ticks=True, first=SER_TICKS):
    """Return a SER file of images (H, W) or (H, W, 3)."""
    height, width = images[0].shape[:2]
    bits = 8 * images[0].dtype.itemsize
    head = b'LUCAM-RECORDER' + struct.pack('<7i', 0, colour, 0, width, height, bits, len(images))
    times = SER_TICKS + 2_500_000 * np.arange(len(images)) if ticks else np.empty(0)
    return (head + b' ' * 120 + struct.pack('<2q', 0, first)
            + b''.join(image.astype(image.dtype.newbyteorder(order)).tobytes()
                       for image in images) + times.astype('<i8').tobytes())


@pytest.mark.parametrize('order', '<>')
def test_ser_is_a_video_and_its_first_frame_an_image(tmp_path, order):
    grey_16 = SKY.astype(np.uint16)
    path = tmp_path / 'a.ser'
    path.write_bytes(ser([grey_16, grey_16 + 7, grey_16 + 9], order=order))
    assert is_video(path)
    found = [*frames(path)]
    assert [frame.number for frame in found] == [0, 1, 2]
    assert [frame.time_s for frame in found] == [0.0, 0.25, 0.5]
    np.testing.assert_array_equal(found[1].image, grey_16 + 7)
    photograph = read_photograph(path)
    np.testing.assert_array_equal(photograph.image, grey_16)
    when = (SER_TICKS - 621_355_968_000_000_000) * 100
    assert photograph.taken == found[0].taken == (when, True, 'SER')
    # Without times; 8 bit colours; damaged ones.
    colours = np.repeat(np.uint8(SKY / 4)[..., None], 3, axis=2)
    path.write_bytes(ser([colours, colours], 100, ticks=False, first=0))
    np.testing.assert_array_equal([frame.time_s for frame in frames(path)], 0)
    np.testing.assert_array_equal(read_image(path), colours[..., 0])
    assert read_photograph(path).taken is None
    whole = path.read_bytes()
    path.write_bytes(whole + b'odd')
    assert len([*frames(path)]) == 2
    path.write_bytes(whole[:178 + colours.nbytes + 5])
    assert len([*frames(path)]) == 1
    huge = whole[:26] + struct.pack('<2i', 40000, 40000) + whole[34:]
    for content, words in ((whole[:100], 'not a SER file'), (whole[:300], 'truncated|no frame'),
                           (huge, '40000 x 40000 px')):
        path.write_bytes(content)
        for read in (read_image, lambda file: [*frames(file)]):
            with pytest.raises(ImageError, match=words):
                read(path)


def xisf(image, compression='', kind='UInt16', more='', at=4096):
    """Return an XISF file of an image (H, W) or planes (C, H, W)."""
    channels = 1 if image.ndim == 2 else len(image)
    data, codec = image.tobytes(), compression.partition('+')[0]
    size = len(data)
    if compression.endswith('+sh'):
        data = np.frombuffer(data, np.uint8).reshape(-1, image.itemsize).T.tobytes()
    data = {'': lambda block: block, 'zlib': zlib.compress,
            'lz4': lambda block: lz4.block.compress(block, store_size=False),
            'zstd': zstandard.ZstdCompressor().compress}[codec](data)
    how = f' compression="{compression}:{size}:{image.itemsize}"' if compression else ''
    head = (f'<?xml version="1.0"?><xisf version="1.0" xmlns="http://www.pixinsight.com/xisf">'
            f'<Image geometry="{image.shape[-1]}:{image.shape[-2]}:{channels}" '
            f'sampleFormat="{kind}"{how} location="attachment:{at}:{len(data)}">'
            f'{more}</Image></xisf>').encode()
    return (b'XISF0100' + struct.pack('<II', len(head), 0) + head).ljust(at, b'\0') + data


@pytest.mark.parametrize('compression', ['', 'zlib', 'zlib+sh', 'lz4', 'lz4+sh', 'zstd+sh'])
def test_xisf_is_read_as_fits_is(tmp_path, compression):
    path, grey_16 = tmp_path / 'a.xisf', SKY.astype('<u2')
    path.write_bytes(xisf(grey_16, compression, more=(
        '<FITSKeyword name="DATE-OBS" value="\'2019-07-29T20:47:26\'" comment=""/>'
        '<FITSKeyword name="OBJCTRA" value="\'05 30 00\'" comment=""/>'
        '<FITSKeyword name="OBJCTDEC" value="\'-10 30 00\'" comment=""/>')))
    photograph = read_photograph(path)
    np.testing.assert_array_equal(photograph.image, grey_16)
    assert photograph.taken == (1564433246 * 10 ** 9, True, 'DATE-OBS')
    assert photograph.pointing_deg == (82.5, -10.5)
    planes = np.stack([SKY, SKY, SKY]).astype('<f4') / 65535
    path.write_bytes(xisf(planes, compression, 'Float32'))
    image = read_image(path).astype(float)
    assert np.corrcoef(image.ravel(), SKY.ravel())[0, 1] > 0.9


@pytest.mark.parametrize('change, words', [
    (lambda content: content[:5000], 'a.xisf'), (lambda content: content[:100], 'a.xisf'),
    (lambda content: content.replace(b'attachment', b'inline'), 'must be an attachment'),
    (lambda content: content.replace(b'UInt16', b'Cplx16'), 'pixels of type Cplx16'),
    (lambda content: content.replace(b'geometry="', b'geometry="9'), 'a.xisf'),
    (lambda content: content.replace(b'<?xml version="1.0"?>', b'<!DOCTYPE a [<!ENTITY b "c">]>'
                                     ), 'not an XISF header')])
def test_xisf_that_is_not_an_image_is_named(tmp_path, change, words):
    (tmp_path / 'a.xisf').write_bytes(change(xisf(SKY.astype('<u2'), 'zlib')))
    with pytest.raises(ImageError, match=words):
        read_image(tmp_path / 'a.xisf')


def test_noise_keeps_its_shape_in_sixteen_bits():
    rng = np.random.default_rng(5)
    values = rng.normal(0, 1e-3, (200, 300)) + np.linspace(0, 1, 300)
    values[50, 60], values[90, 20], values[10, 10] = 1e6, np.nan, -1e6
    levels = sixteen_bit(values.astype(np.float32)).astype(float)
    step = 1e-3 / 4
    inner = (levels > 0) & (levels < 65535)
    assert inner.mean() > 0.998
    change = np.abs(np.diff(levels, axis=0)[inner[1:] & inner[:-1]])
    noise = 1.4826 * np.median(change) / np.sqrt(2)
    assert noise == pytest.approx(1e-3 / step, rel=0.1)
    assert levels[50, 60] == 65535


@pytest.mark.parametrize('name, content, library, extra', [
    ('a.fits', b'SIMPLE  =                    T', 'astropy', 'fits'),
    ('a.NEF', b'MM\0*', 'rawpy', 'raw')])
def test_the_extra_is_named(tmp_path, monkeypatch, name, content, library, extra):
    for module in [*sys.modules]:
        if module.partition('.')[0] == library:
            monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, library, None)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ImageError) as raised:
        read_image(tmp_path / name)
    assert str(raised.value).startswith(f'{tmp_path / name}: ')
    assert f'needs {library}: {install_hint(extra)}' in str(raised.value)


def dng(mosaic):
    """Return a minimal DNG of a Bayer mosaic (H, W) uint16, red first."""
    height, width = mosaic.shape
    tags = {254: ('I', [0]), 256: ('I', [width]), 257: ('I', [height]), 258: ('H', [16]),
            259: ('H', [1]), 262: ('H', [32803]), 273: ('I', [0]), 274: ('H', [1]),
            277: ('H', [1]), 278: ('I', [height]), 279: ('I', [mosaic.nbytes]),
            33421: ('H', [2, 2]), 33422: ('B', [0, 1, 1, 2]), 50706: ('B', [1, 4, 0, 0]),
            50708: ('s', b'Test camera\0'), 50714: ('H', [100]), 50717: ('I', [16383]),
            50721: ('r', [1, 0, 0, 0, 1, 0, 0, 0, 1]), 50728: ('R', [1, 1, 1]),
            50778: ('H', [21])}
    kinds = {'B': 1, 's': 2, 'H': 3, 'I': 4, 'R': 5, 'r': 10}
    at, entries, tail = 8 + 2 + 12 * len(tags) + 4, b'', b''
    for tag, (kind, values) in sorted(tags.items()):
        if kind == 's':
            data = values
        elif kind in 'Rr':
            data = b''.join(struct.pack('<ii', value, 1) for value in values)
        else:
            data = struct.pack(f'<{len(values)}{kind}', *values)
        if tag == 273:
            entries += b'STRIPS......'
            continue
        if len(data) > 4:
            field, tail = struct.pack('<I', at + len(tail)), tail + data + b'\0' * (len(data) % 2)
        else:
            field = data.ljust(4, b'\0')
        entries += struct.pack('<HHI', tag, kinds[kind], len(values)) + field
    entries = entries.replace(b'STRIPS......', struct.pack('<HHII', 273, 4, 1, at + len(tail)))
    return (b'II*\0' + struct.pack('<IH', 8, len(tags)) + entries + bytes(4) + tail
            + mosaic.astype('<u2').tobytes())


def test_raw_is_the_mean_of_the_cells_of_the_mosaic(tmp_path):
    rng = np.random.default_rng(4)
    mosaic = rng.integers(150, 300, (80, 120)).astype(np.uint16)
    mosaic[20:22, 40:42] = 8000
    (tmp_path / 'a.dng').write_bytes(dng(mosaic))
    photograph = read_photograph(tmp_path / 'a.dng')
    assert photograph.image.dtype == np.uint16 and photograph.image.shape == (40, 60)
    assert np.unravel_index(photograph.image.argmax(), (40, 60)) == (10, 20)
    cells = mosaic.astype(float) - 100
    red, blue = cells[::2, ::2], cells[1::2, 1::2]
    green = (cells[::2, 1::2] + cells[1::2, ::2]) / 2
    grey = (red + green + blue) / 3
    ratio = photograph.image[10, 20] / grey[10, 20]
    np.testing.assert_allclose(photograph.image[2:-2, 2:-2], ratio * grey[2:-2, 2:-2], rtol=0.03)
    orientations = (struct.pack('<HHIHH', 274, 3, 1, turn, 0) for turn in (1, 6))
    (tmp_path / 'b.dng').write_bytes(dng(mosaic).replace(*orientations))
    np.testing.assert_array_equal(read_image(tmp_path / 'b.dng'),
                                  np.rot90(photograph.image, -1))


@pytest.mark.parametrize('content', [b'', b'MM\0*', b'II*\0' + bytes(5000)])
def test_raw_that_is_damaged(tmp_path, content):
    (tmp_path / 'a.nef').write_bytes(content)
    with pytest.raises(ImageError, match='a.nef'):
        read_image(tmp_path / 'a.nef')


def test_folders_have_fits_and_raw(tmp_path):
    for name in ('a.fits', 'b.NEF', 'c.FIT'):
        (tmp_path / name).touch()
    assert [path.name for path in image_paths([tmp_path])] == ['a.fits', 'b.NEF', 'c.FIT']

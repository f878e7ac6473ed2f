# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames of videos, animated images and paged files."""

import cv2
import numpy as np
from PIL import Image
import pytest
from startracker_ros.io.images.images import grey, ImageError
from startracker_ros.io.images.video import frames, is_video


def noise(count, dtype=np.uint8, shape=(48, 64)):
    rng = np.random.default_rng(5)
    return [rng.integers(0, np.iinfo(dtype).max, shape).astype(dtype) for _ in range(count)]


def write_video(path, images, rate_hz=10.0):
    height, width = images[0].shape
    video = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*'FFV1'), rate_hz, (width, height),
        [cv2.VIDEOWRITER_PROP_IS_COLOR, 0])
    for image in images:
        video.write(image)
    video.release()


def write_pages(path, images, **options):
    first, *others = map(Image.fromarray, images)
    first.save(path, save_all=True, append_images=others, **options)


def frames_with_times(path):
    """Return the images of a video of four frames at 10 Hz."""
    assert is_video(path)
    found = list(frames(path))
    assert [frame.number for frame in found] == [0, 1, 2, 3]
    np.testing.assert_allclose([frame.time_s for frame in found], [0.0, 0.1, 0.2, 0.3], atol=1e-9)
    return np.array([frame.image for frame in found])


def test_frames_of_a_lossless_video_are_exact(tmp_path):
    write_video(tmp_path / 'a.mkv', noise(4))
    np.testing.assert_array_equal(frames_with_times(tmp_path / 'a.mkv'), noise(4))


def test_frames_of_16_bit_are_exact_or_what_an_old_opencv_has_of_them(sky_data):
    """The file has noise(4, np.uint16), as VIDEOWRITER_PROP_DEPTH of OpenCV 4.7 writes it."""
    found = frames_with_times(sky_data / 'grey_16_bit.mkv')
    if tuple(map(int, cv2.__version__.split('.')[:2])) >= (4, 7):
        np.testing.assert_array_equal(found, noise(4, np.uint16))
    else:
        assert found.dtype == np.uint8
        np.testing.assert_allclose(found, np.array(noise(4, np.uint16)) / 256, atol=1)


@pytest.mark.parametrize('name, dtype', [
    ('a.gif', np.uint8), ('a.png', np.uint8), ('a.webp', np.uint8), ('a.tif', np.uint8),
    ('a.tif', np.uint16)])
def test_pages_of_an_image_file_are_exact(tmp_path, name, dtype):
    images = noise(3, dtype)
    write_pages(tmp_path / name, images, **({'lossless': True} if name == 'a.webp' else {}),
                **({} if name == 'a.tif' else {'duration': 200}))
    assert is_video(tmp_path / name)
    found = list(frames(tmp_path / name))
    np.testing.assert_array_equal([frame.image for frame in found], images)
    assert found[2].image.dtype == dtype
    if name in ('a.gif', 'a.png'):
        assert found[2].time_s == pytest.approx(0.4)


def test_pages_of_a_png_of_16_bit_are_exact(tmp_path):
    # Dark ones: Pillow before 10.3 compares pages at 8 bit to leave out those that repeat.
    images = [image // 257 for image in noise(3, np.uint16)]
    write_pages(tmp_path / 'a.png', images)
    found = [frame.image for frame in frames(tmp_path / 'a.png')]
    np.testing.assert_array_equal(found, images)
    assert found[0].dtype == np.uint16


def test_pages_of_floats_are_scaled_to_16_bits(tmp_path):
    write_pages(tmp_path / 'a.tif', [image.astype(np.float32) / 255 for image in noise(2)])
    for frame, image in zip(frames(tmp_path / 'a.tif'), noise(2)):
        assert frame.image.dtype == np.uint16
        assert np.corrcoef(frame.image.ravel(), image.ravel())[0, 1] > 0.99


def test_one_image_is_not_a_video_and_neither_is_a_thumbnail_a_frame(tmp_path):
    cv2.imwrite(str(tmp_path / 'one.png'), noise(1)[0])
    write_pages(tmp_path / 'thumbnail.tif', [noise(1)[0], noise(1, shape=(6, 8))[0]])
    (tmp_path / 'damaged.gif').write_bytes(b'GIF89a')
    for name in ('one.png', 'thumbnail.tif', 'damaged.gif', 'missing.tif', 'photo.jpg'):
        assert not is_video(tmp_path / name), name


def test_what_is_not_a_video_is_named(tmp_path, monkeypatch):
    (tmp_path / 'junk.mkv').write_bytes(b'no video' * 100)
    for name, reason in (('junk.mkv', 'not a video'), ('missing.mkv', 'no such file')):
        with pytest.raises(ImageError, match=f'{name}: {reason}'):
            next(frames(tmp_path / name))
    write_video(tmp_path / 'large.mkv', noise(1))
    monkeypatch.setattr('startracker_ros.io.images.video.MOST_PIXELS', 1000)
    with pytest.raises(ImageError, match='64 x 48 px'):
        next(frames(tmp_path / 'large.mkv'))


def test_a_truncated_video_has_its_first_frames(tmp_path):
    write_video(tmp_path / 'a.mkv', noise(8))
    content = (tmp_path / 'a.mkv').read_bytes()
    (tmp_path / 'short.mkv').write_bytes(content[:len(content) // 2])
    found = list(frames(tmp_path / 'short.mkv'))
    assert 2 <= len(found) < 8
    np.testing.assert_array_equal(found[0].image, noise(8)[0])


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16])
def test_grey_is_the_rounded_mean_of_the_colours(dtype):
    colours = np.stack(noise(4, dtype), axis=2)
    expected = colours[..., :3].mean(axis=2).round().astype(dtype)
    np.testing.assert_array_equal(grey(colours), expected)
    np.testing.assert_array_equal(grey(colours[..., :3]), expected)
    np.testing.assert_array_equal(grey(colours[..., :1]), colours[..., 0])
    assert grey(colours).dtype == dtype

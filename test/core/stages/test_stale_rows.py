# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows that are those of the image before."""

import numpy as np
import pytest
from startracker_ros.core.stages.extraction import StaleRows


def noise(seed, shape=(512, 640)):
    return np.random.default_rng(seed).normal(100, 4, shape).astype(np.uint16)


def found(*images):
    rows = StaleRows()
    return [rows.find(image) for image in images][-1]


def test_new_images_have_no_stale_rows():
    assert found(noise(0)) == found(noise(0), noise(1)) == (0, 0)
    assert found(noise(0), noise(0)[:256]) == (0, 0)


@pytest.mark.parametrize('row', [40, 200, 480])
def test_both_parts_of_a_torn_image_are_found(row):
    torn = noise(1)
    torn[row:] = noise(0)[row:]
    first, last = found(noise(0), torn)
    assert row <= first < row + 8 and last == 511
    torn = noise(1)
    torn[:row] = noise(0)[:row]
    first, last = found(noise(0), torn)
    assert first == 0 and row - 8 <= last < row


def test_a_repeated_image_is_stale_as_a_whole():
    assert found(noise(0), noise(0)) == (0, 511)


@pytest.mark.parametrize('dark', [0, 100])
def test_images_that_differ_are_told_from_one_that_is_shown_again(dark):
    rows, images = StaleRows(), [noise(0), noise(1)]
    for image in images:
        image[:dark] = 0
    rows.find(images[0])
    rows.find(images[0])
    assert not rows.vary
    rows.find(images[1])
    assert rows.vary


def test_rows_without_noise_say_nothing():
    dark = np.zeros((512, 640), np.uint16)
    assert found(dark, dark) == (0, 0)
    dead = [noise(seed) for seed in (0, 1)]
    for image in dead:
        image[:100] = 0
    assert found(*dead) == (0, 0)


def test_few_rows_with_noise_say_nothing():
    # Compression leaves it about the stars only, and some of it as it was in the image before.
    compressed = [np.zeros((512, 640), np.uint16) for _ in range(2)]
    for seed, image in enumerate(compressed):
        image[:80] = noise(seed)[:80]
        image[:16] = noise(2)[:16]
    assert found(*compressed) == (0, 0)


def test_noise_that_is_the_same_in_every_image_says_nothing():
    before, after = noise(0), noise(0)
    after[64:72] += 50
    after[300:310] += 50
    assert found(before, after) == (0, 0)

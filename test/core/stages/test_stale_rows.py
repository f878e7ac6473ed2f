# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows that are those of the image before."""

import re

import numpy as np
import pytest
from startracker_ros.core.stages.extraction import ExtractionStage

STEP_NS = 100_000_000


def noise(seed, shape=(512, 640)):
    return np.random.default_rng(seed).normal(100, 4, shape).astype(np.uint16)


def found(*images):
    """Return status and reason of the last of images."""
    stage = ExtractionStage()
    return [(found.status, found.reason) for found in (
        stage.process(index * STEP_NS, image) for index, image in enumerate(images, 1))][-1]


def torn(*images):
    """Return the first and the last row that are torn in the last of images, (0, 0) for none."""
    status, reason = found(*images)
    return tuple(map(int, re.findall(r'\d+', reason))) if status == 'torn' else (0, 0)


def test_new_images_have_no_stale_rows():
    assert torn(noise(0)) == torn(noise(0), noise(1)) == (0, 0)
    assert torn(noise(0), noise(0)[:256]) == (0, 0)


@pytest.mark.parametrize('row', [40, 200, 480])
def test_both_parts_of_a_torn_image_are_found(row):
    image = noise(1)
    image[row:] = noise(0)[row:]
    first, last = torn(noise(0), image)
    assert row <= first < row + 8 and last == 511
    image = noise(1)
    image[:row] = noise(0)[:row]
    first, last = torn(noise(0), image)
    assert first == 0 and row - 8 <= last < row


@pytest.mark.parametrize('dark', [0, 100])
def test_images_that_differ_are_told_from_one_that_is_shown_again(dark):
    one, other = noise(0), noise(1)
    one[:dark] = other[:dark] = 0
    assert found(one, one, one)[0] not in ('repeated', 'torn')
    assert found(one, one, other)[0] not in ('repeated', 'torn')
    assert found(one, one, other, other)[0] == 'repeated'


def test_rows_without_noise_say_nothing():
    dark = np.zeros((512, 640), np.uint16)
    assert found(noise(0), noise(1), dark, dark)[0] == 'blank'
    dead = [noise(seed) for seed in (0, 1)]
    for image in dead:
        image[:100] = 0
    assert torn(*dead) == (0, 0)


def test_few_rows_with_noise_say_nothing():
    # Compression leaves it about the stars only, and some of it as it was in the image before.
    compressed = [np.zeros((512, 640), np.uint16) for _ in range(2)]
    for seed, image in enumerate(compressed):
        image[:80] = noise(seed)[:80]
        image[:16] = noise(2)[:16]
    assert torn(*compressed) == (0, 0)


def test_noise_that_is_the_same_in_every_image_says_nothing():
    before, after = noise(0), noise(0)
    after[64:72] += 50
    after[300:310] += 50
    assert torn(before, after) == (0, 0)

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The native core finds in images what Python found in them, which is recorded."""

from native_core import build_module, built, compiler
from native_extraction import assert_same, cases, Found, NativeTracker, recorded
import pytest
from skies import START_NS
from startracker_ros.core.centroid.extraction import CentroidExtractor

CASES, RECORDED = cases(), recorded()


@pytest.mark.parametrize('name', CASES)
def test_stars_and_rejected_spots_of_an_image_are_those_recorded(name):
    image, options = CASES[name]
    tracker = NativeTracker(image.shape, options)
    assert_same(tracker.extract(START_NS, image, lost=False), RECORDED[name])
    assert tracker.is_intact


@pytest.mark.parametrize('name', CASES)
def test_a_search_of_one_image_finds_the_same(name):
    image, options = CASES[name]
    assert_same(Found.by_python(CentroidExtractor(options).measure(image)), RECORDED[name])


def test_all_that_is_recorded_is_compared():
    assert list(RECORDED) == list(CASES)


def test_the_library_takes_no_memory():
    library = built(build_module().library(compiler()), 'libstartracker.so').read_bytes()
    assert b'st_extract' in library and b'memcpy' in library
    for name in (b'malloc', b'calloc', b'_Znw', b'mmap', b'pthread', b'fopen'):
        assert name not in library, name

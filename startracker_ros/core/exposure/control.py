# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Exposure time and gain with the most information on the attitude, one step for each image.

While there are stars the setting within reach is chosen whose predicted information is largest.
A change after which the stars are gone is taken back, and the next ones are
smaller. Without stars the setting is the last one that had some, less where the background would
fill the pixels, and others around it are tried in turn: it never moves away for good.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from startracker_ros.core.centroid.streak import SHORTEST_PX
from startracker_ros.core.exposure.image_figures import ImageFigures
from startracker_ros.core.options import option, Options

# --- the information on the attitude that the stars of an image would have at other settings ---

# The number of stars grows by 10^(0.45 m) with magnitude m near V = 6, and so by this power of
# the flux.
_COUNT_SLOPE = 1.1
_FAINTER = 100  # stars beyond those that were found
_SEEN_SNR = 4.0, 7.0  # from none to all stars of this signal to noise ratio are detected
_ERROR_PX = 0.05  # of a star whatever its signal: catalogue, lens, pixels
_SATURATED_PX = 0.3  # of one that is fitted by its flanks
_SMEARED = 0.03  # of a streak: the motion is not quite uniform
_ROUNDING = 1 / 12  # DN^2, variance of a rounded level
_DARKEST = 0.25  # part of the field in which the stars are seen if the rest is too bright
_SATURATED = 0.95  # of the full scale, with the noise


class Converter(NamedTuple):
    """The levels of a pixel without light, and where it saturates, in DN."""

    dark_dn: float
    full_scale_dn: float


def filled(figures: ImageFigures, converter: Converter) -> float:
    """Return the part of the full scale that the background fills in the darkest quarter."""
    dark_dn, full_scale_dn = converter
    background_dn = float(np.quantile(figures.levels_dn, _DARKEST))
    return (background_dn - dark_dn) / (full_scale_dn - dark_dn)


def information(figures: ImageFigures, converter: Converter, longer: np.ndarray,
                amplified: np.ndarray) -> np.ndarray:
    """
    Return the information (C,) in 1/px^2 at longer (C,) times the exposure.

    amplified (C,) is the gain by those of the image. It is the sum of the inverse variances of
    the stars, those included that would appear or saturate. The variance of the flux F of a star
    is k F + a: photons of the star, read noise and photons of the background, the share of the
    last by the same k. There must be a star.
    """
    dark_dn, full_dn = converter
    f, h = longer[:, None], amplified[:, None]
    gain_dn, floor = _flux_variance(figures)
    variance = max(figures.noise_dn ** 2, _ROUNDING)
    sky = min(max(gain_dn * (figures.background_dn - dark_dn) / variance, 0.0), 1.0)
    flux, peak_dn = _with_fainter(figures)
    # The pixels over which the background counts grow with the streak.
    sharp = figures.psf_sigma_px
    along, long = (np.sqrt(sharp ** 2 + (figures.streak_px * times) ** 2 / 12)
                   for times in (1.0, f))
    pixel = h ** 2 * (variance - _ROUNDING) * (1 + sky * (f - 1)) + _ROUNDING
    snr = flux * f * h / np.sqrt(
        gain_dn * flux * f * h ** 2 + floor * pixel / variance * long / along)
    own = (np.where((peak_dn - dark_dn) * f * h < _SATURATED * (full_dn - dark_dn),
                    _ERROR_PX, _SATURATED_PX) ** 2
           + (_SMEARED * figures.streak_px * f) ** 2)
    low, high = _SEEN_SNR
    seen = ((snr - low) / (high - low)).clip(0, 1)
    snr = np.maximum(snr, low)
    each = (1 / ((sharp / snr) ** 2 + own) + 1 / ((long / snr) ** 2 + own)) / 2
    return (seen * each).sum(axis=1) * _regained(figures, converter, longer * amplified)


def _flux_variance(figures: ImageFigures) -> tuple[float, float]:
    """Return k in DN and a in DN^2 of the variance k F + a of the fluxes F of the stars."""
    variance = (figures.flux / figures.snr) ** 2
    (gain_dn, floor), _ = nnls(np.stack([figures.flux, np.ones_like(variance)], 1)
                               / variance[:, None], np.ones(len(variance)))
    return float(gain_dn), float(floor)


def _with_fainter(figures: ImageFigures) -> tuple[np.ndarray, np.ndarray]:
    """Return fluxes and peaks of the stars, followed by fainter ones as the sky has them."""
    least, count = np.argmin(figures.flux), len(figures.flux)
    share = ((count + np.arange(_FAINTER) + 0.5) / count) ** (-1 / _COUNT_SLOPE)
    return (np.append(figures.flux, figures.flux[least] * share),
            np.append(figures.peak_dn, np.full(_FAINTER, figures.peak_dn.min())))


def _regained(figures: ImageFigures, converter: Converter, brighter: np.ndarray) -> np.ndarray:
    """
    Return the part (C,) of the field that can be used, by that of the image, if less saturates.

    Behind full pixels a gradient is taken to go on as before them; the edge of a disc has none.
    """
    dark_dn, full_dn = converter
    limit_dn = _SATURATED * (full_dn - dark_dn)
    light_dn = figures.levels_dn - dark_dn
    full = np.mean(light_dn >= limit_dn)
    below = (light_dn < limit_dn) & (light_dn >= limit_dn * brighter[:, None])
    return 1 + np.minimum(below.mean(axis=1), full) / max(1 - full, 0.01)


# --- settings ---

LEAST_STARS = 4
_REACH = 1.0  # octaves of a step
_LEAST_REACH = 0.1
_WIDENED = 1.3  # with each image that has stars
_WORTH = 1.1  # times the information: for less nothing is changed
_HEADROOM = 0.1  # power of the amplification for which it has to be worth it
_STEPS = np.arange(-4, 5) / 4  # of the reach
# Of the full scale, by the background: what is aimed at, and what is left as it is, so that a
# background that grows has some images left.
_FILLED, _MOST_FILLED = 0.45, 0.7
_FULL = 0.95  # of the full scale, from which a background has no known level
_DARKER_IF_FULL = 0.25
# Exponents of 4 around the last setting with stars, which comes back every other time.
_TRIED = (0, 0, 0, *(one for power in range(1, 7) for one in (power, 0, -power, 0)))
_LEAST_CHANGE, _DARK_SHARE = 1.15, 0.3  # of the exposure, for the dark level


class Setting(NamedTuple):
    """Exposure time in ms, and gain in units of the driver."""

    exposure_ms: float
    gain: float


@dataclass(frozen=True)
class ExposureMode(Options):
    """Who chooses exposure time and gain."""

    exposure: str = option(
        'manual', 'manual: exposure_ms and gain stay as they are set; auto: the stars in the '
        'images choose them, beginning there', choices=('manual', 'auto'))


@dataclass(frozen=True)
class ExposureOptions(Options):
    """The limits of exposure time and gain."""

    exposure_min_ms: float = option(0.1, 'shortest exposure time that is chosen', unit='ms',
                                    low=0.01, high=600_000.0)
    exposure_max_ms: float = option(
        0.0, 'longest exposure time that is chosen; 0: the period of the frames', unit='ms',
        low=0.0, high=600_000.0)
    gain_min: float = option(
        -1.0, 'lowest gain that is chosen, in units of the driver', low=-1.0, high=1e6)
    gain_max: float = option(
        -1.0, 'highest gain that is chosen; not above gain_min: the gain stays', low=-1.0,
        high=1e6)
    gain_db: float = option(
        0.0, 'dB by which a unit of the gain amplifies (20 dB are a factor of 10), often 0.1; 0: '
        'the gain is a factor', unit='dB', low=0.0, high=20.0)


class ExposureLimits(NamedTuple):
    """The settings that a camera may have; gain_db as in the options."""

    low: Setting
    high: Setting
    gain_db: float = 0.0

    @classmethod
    def of(cls, options: ExposureOptions, period_ms: float, gain: float) -> 'ExposureLimits':
        """Return the limits of a camera with this period of frames and, if it stays, gain."""
        longest_ms = max(options.exposure_max_ms or period_ms, options.exposure_min_ms)
        gains = (options.gain_min, options.gain_max)
        low, high = gains if 0 <= gains[0] < gains[1] else (gain, gain)
        return cls(Setting(options.exposure_min_ms, low), Setting(longest_ms, high),
                   options.gain_db)

    def amplification(self, gain: float) -> float:
        """Return the factor of a gain."""
        return 10 ** (self.gain_db * gain / 20) if self.gain_db else max(gain, 1e-3)

    def brightness(self, setting: Setting) -> float:
        """Return exposure time in ms by amplification."""
        return setting.exposure_ms * self.amplification(setting.gain)

    def setting(self, exposure_ms: float, amplification: float) -> Setting:
        """Return the setting within the limits."""
        gain = 20 * np.log10(amplification) / self.gain_db if self.gain_db else amplification
        return Setting(float(np.clip(exposure_ms, self.low.exposure_ms, self.high.exposure_ms)),
                       float(np.clip(gain, self.low.gain, self.high.gain)))

    def as_bright(self, brightness: float, like: Setting) -> Setting:
        """Return a setting of this brightness: another gain only where no exposure has it."""
        exposure_ms = self.setting(
            brightness / self.amplification(like.gain), 1.0).exposure_ms
        return self.setting(exposure_ms, brightness / exposure_ms)


@dataclass(frozen=True)
class ControlState:
    """
    What is known after an image.

    starry is the last setting that had stars, or the first one; starless the number of images
    without stars since; reach the octaves of a step; streak_px_ms the motion of the stars.
    before is the last setting with the background in DN that it had.
    """

    starry: Setting
    converter: Converter = Converter(0.0, 0.0)
    streak_px_ms: float = 0.0
    starless: int = 0
    reach: float = _REACH
    before: tuple[Setting, float] | None = None


class Decision(NamedTuple):
    """The state after an image, and the setting of the next one."""

    state: ControlState
    setting: Setting


def next_setting(state: ControlState, setting: Setting, figures: ImageFigures,
                 limits: ExposureLimits) -> Decision:
    """Return the setting after an image that was taken with a setting."""
    state = _estimated(state, setting, figures)
    fill = filled(figures, state.converter)
    full = fill >= _FULL
    if len(figures.flux) >= LEAST_STARS and not full:
        state = replace(state, streak_px_ms=_motion_px_ms(state, setting, figures))
        chosen = _best(state, setting, figures, limits)
        return Decision(replace(state, starry=setting, starless=0,
                                reach=min(_REACH, _WIDENED * state.reach)), chosen)
    # The change since the last stars was one too many.
    lost = state.starless == 0 and setting != state.starry
    reach = max(state.reach / 2, _LEAST_REACH) if lost else state.reach
    brightness = limits.brightness(setting)
    most = brightness * (_DARKER_IF_FULL if full else _FILLED / max(fill, 1e-6))
    starry = limits.brightness(state.starry)
    if most < starry:
        # Stars that the background hides are lost in a darker image, too.
        return Decision(replace(state, starless=1, reach=reach),
                        limits.as_bright(most, state.starry))
    tried = starry * 4.0 ** _TRIED[state.starless % len(_TRIED)]
    return Decision(replace(state, starless=state.starless + 1, reach=reach),
                    limits.as_bright(min(tried, most), state.starry))


def _best(state: ControlState, setting: Setting, figures: ImageFigures, limits: ExposureLimits
          ) -> Setting:
    """Return the setting within reach with the most information, if that is worth a change."""
    factors = 2.0 ** (state.reach * _STEPS)
    amplification = limits.amplification(setting.gain)
    settings = [setting] + list(dict.fromkeys(
        limits.setting(setting.exposure_ms * longer, amplification * amplified)
        for longer in factors for amplified in factors[::2]))
    longer, amplified = np.array([
        (one.exposure_ms / setting.exposure_ms, limits.amplification(one.gain) / amplification)
        for one in settings]).T
    figures = replace(figures, streak_px=state.streak_px_ms * setting.exposure_ms)
    values = information(figures, state.converter, longer, amplified) / amplified ** _HEADROOM
    fill = filled(figures, state.converter)
    brighter = longer * amplified
    stays = (brighter <= 1) & (fill < _MOST_FILLED)
    values[~stays & (fill * brighter > _FILLED)] = 0.0
    best = int(np.argmax(values))
    if values[best] > _WORTH * values[0]:
        return settings[best]
    # Too much background at every setting: the darkest.
    return setting if values[0] > 0 else settings[int(np.argmin(brighter))]


def _motion_px_ms(state: ControlState, setting: Setting, figures: ImageFigures) -> float:
    """Return the motion of the stars; where they are points it was no more than these hide."""
    if figures.streak_px:
        return figures.streak_px / setting.exposure_ms
    return min(state.streak_px_ms, SHORTEST_PX / setting.exposure_ms)


def _estimated(state: ControlState, setting: Setting, figures: ImageFigures) -> ControlState:
    """
    Return the state with full scale and dark level as an image shows them.

    The background grows from the dark level in proportion to the exposure.
    """
    dark_dn, full_dn = state.converter
    if np.isfinite(figures.full_scale_dn):
        full_dn = figures.full_scale_dn
    elif figures.brightest_dn >= full_dn:
        full_dn = figures.range_dn
    background_dn = figures.background_dn
    if state.before is not None and background_dn < _FULL * full_dn:
        before, before_dn = state.before
        times = setting.exposure_ms / before.exposure_ms
        if before.gain == setting.gain and not 1 / _LEAST_CHANGE < times < _LEAST_CHANGE:
            seen_dn = (times * before_dn - background_dn) / (times - 1)
            seen_dn = float(np.clip(seen_dn, 0, min(before_dn, background_dn)))
            dark_dn += _DARK_SHARE * (seen_dn - dark_dn)
    return replace(state, converter=Converter(min(dark_dn, background_dn), full_dn),
                   before=(setting, background_dn))

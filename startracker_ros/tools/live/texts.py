# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of the live view as texts, the figure in the first line of each."""

from collections.abc import Mapping
from typing import Any

import erfa
import numpy as np
from startracker_ros.core.catalog.constellations import NAMES

_UNKNOWN = '-'


def state_texts(figures: Mapping[str, Any], reason: str, camera: str) -> dict[str, str]:
    """Return the texts of LiveRig.figures() by label, with the reason of the state."""
    pointing = dict.fromkeys(
        ('right ascension', 'declination', 'roll', 'constellation'), _UNKNOWN)
    ra_deg, dec_deg, roll_deg = (figures[f'{name}_deg'] for name in ('ra', 'dec', 'roll'))
    if np.isfinite(ra_deg):
        ra_sigma, dec_sigma, roll_sigma = (f'sigma {_rounded(figures[f"{name}_sigma_arcsec"])} '
                                           'arcsec' for name in ('ra', 'dec', 'roll'))
        pointing = {
            'right ascension': f'{hours_text(ra_deg)}\n{ra_deg:.4f} deg\n{ra_sigma}',
            'declination': f'{degrees_text(dec_deg)}\n{dec_deg:+.4f} deg\n{dec_sigma}',
            'roll': f'{roll_deg:.4f} deg\n{roll_sigma}',
            'constellation': NAMES[figures['constellation']]}
    rate_deg_s = figures['rate_deg_s']
    return {
        'state': f'{figures["state"]}\n{reason}'.rstrip(), **pointing,
        'rate': f'{rate_deg_s:.4f} deg/s' if np.isfinite(rate_deg_s) else _UNKNOWN,
        'stars tracked': str(figures['stars']),
        'focus': focus_text(figures['fwhm_px']),
        'exposure': exposure_text(figures['exposure_ms'], figures['gain']),
        'camera': f'{camera}\n{figures["frames"]} frames'.lstrip()}


def hours_text(ra_deg: float) -> str:
    """Return a right ascension in hours, minutes and seconds to 0.01 s."""
    _, parts = erfa.a2tf(2, np.radians(ra_deg))
    hours, minutes, seconds, hundredths = parts.item()
    return f'{hours % 24:02d}h{minutes:02d}m{seconds:02d}.{hundredths:02d}s'


def degrees_text(dec_deg: float) -> str:
    """Return a declination in degrees, minutes and seconds of arc to 0.1 arcsec."""
    sign, parts = erfa.a2af(1, np.radians(dec_deg))
    degrees, minutes, seconds, tenths = parts.item()
    return f'{sign.item().decode()}{degrees:02d}d{minutes:02d}\'{seconds:02d}.{tenths}"'


def focus_text(fwhm_px: float) -> str:
    """Return the width of the star images, which is smallest in focus."""
    return f'{fwhm_px:.2f} px\nFWHM of the stars' if np.isfinite(fwhm_px) else _UNKNOWN


def exposure_text(exposure_ms: float, gain: float) -> str:
    """Return exposure time and gain, as far as they are known."""
    if not np.isfinite(exposure_ms):
        return _UNKNOWN
    return f'{exposure_ms:.4g} ms' + (f'\ngain {gain:.4g}' if gain >= 0 else '')


def _rounded(value: float) -> str:
    """Return a number with two digits, without an exponent."""
    return np.format_float_positional(float(f'{value:.2g}'), trim='-')

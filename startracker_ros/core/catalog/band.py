# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Magnitudes in the band of an instrument, from V and the colour BP - RP of Gaia."""

from dataclasses import dataclass, fields, replace

import numpy as np
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.options import option, Options

V_BAND, HP_BAND, G_BAND = 'V', 'Hp', 'G'

BANDS = (V_BAND, HP_BAND, G_BAND)

COLOUR_BAND = 'colour'
"""V + colour_term (G - V), the band that calibration fits to a camera."""

# G - V in powers of BP - RP: Riello et al. (2021), A&A 649, A3, appendix C; rms 0.03 mag.
_G_MINUS_V = (-0.02704, 0.01424, -0.2156, 0.01426)

# BP - RP and Hp - V: medians of the Hipparcos stars of V 9 and fainter that Gaia has, too.
_HP_MINUS_V = np.array([
    (-0.4, -0.080), (-0.2, -0.035), (0.0, 0.008), (0.2, 0.049), (0.4, 0.077), (0.6, 0.101),
    (0.8, 0.128), (1.0, 0.153), (1.2, 0.167), (1.4, 0.163), (1.6, 0.142), (1.8, 0.118),
    (2.0, 0.106), (2.2, 0.083), (2.4, 0.058), (3.0, -0.026), (3.5, -0.163), (4.0, -0.401)]).T

_BLUEST, _REDDEST = -0.5, 4.0


@dataclass(frozen=True)
class BandOptions(Options):
    """The band in which magnitudes are predicted."""

    band: str = option(
        V_BAND, 'band of the magnitudes, also of the limits: V, Hp of Hipparcos, G of Gaia, or '
        'colour for V + colour_term (G - V); the same for all nodes',
        choices=(*BANDS, COLOUR_BAND))
    colour_term: float = option(
        0.5, 'colour term of band colour, as `startracker calibrate` prints it: 0 is V, 1 is G',
        low=-2.0, high=3.0)


def catalog_in_band(catalog: StarCatalog, options: BandOptions) -> StarCatalog:
    """Return the stars with their magnitudes in a band, brightest first."""
    if options.band == V_BAND:
        return catalog
    v, band = catalog.magnitude, options.band
    if band == COLOUR_BAND:
        zero = np.zeros(len(v))
        magnitude = v + options.colour_term * magnitude_in_band(zero, catalog.bp_rp, G_BAND)
    else:
        magnitude = magnitude_in_band(v, catalog.bp_rp, band)
    other = replace(catalog, magnitude=magnitude.astype(np.float32))
    order = np.argsort(other.magnitude, kind='stable')
    return StarCatalog(*(getattr(other, field.name)[order] for field in fields(StarCatalog)))


def magnitude_in_band(v: np.ndarray, bp_rp: np.ndarray, band: str) -> np.ndarray:
    """
    Return magnitudes (N,) in a band of BANDS, of Johnson V (N,) and BP - RP (N,).

    Colours outside -0.5 .. 4 have the correction of the nearer limit.
    """
    colour = np.clip(bp_rp, _BLUEST, _REDDEST)
    if band == G_BAND:
        return v + np.polynomial.polynomial.polyval(colour, _G_MINUS_V)
    if band == HP_BAND:
        return v + np.interp(colour, *_HP_MINUS_V)
    return np.asarray(v)

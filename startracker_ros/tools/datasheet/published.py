# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Figures that manufacturers publish of their star trackers, to put beside those of a simulation.

Each is quoted as its data sheet states it: 3 sigma or 1 sigma, end of life or not. None was
measured here. A simulation has no manufacturing, no temperature and no ageing.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class PublishedUnit:
    """Errors in arcsec across and about the boresight at so many sigma, limits, source."""

    unit: str
    sigma: str
    cross_arcsec: float
    about_arcsec: float
    rate_deg_s: float | None
    update_hz: float | None
    acquisition_s: float | None
    source: str


_AURIGA = 'Sodern, Auriga brochure, p. 5, end of life, worst case'

PUBLISHED = (
    PublishedUnit('Sodern Auriga, field-of-view error', '3', 9.0, 51.0, 3.0, None, 3.8, _AURIGA),
    PublishedUnit('Sodern Auriga, pixel error', '3', 6.6, 38.0, 3.0, None, 3.8, _AURIGA),
    PublishedUnit('Sodern Auriga, temporal noise', '3', 11.0, 70.0, 3.0, None, 3.8, _AURIGA),
    PublishedUnit('Rocket Lab ST-16RT2', 'not stated', 5.0, 55.0, 3.0, None, None,
                  'Rocket Lab (Sinclair Interplanetary), ST-16RT2 data sheet'),
    PublishedUnit('arcsec Sagitta', '1', 2.0, 10.0, None, 10.0, None,
                  'arcsec, Sagitta Star Tracker Datasheet v2'),
    PublishedUnit('arcsec Twinkle', 'not stated', 15.0, 90.0, None, None, None,
                  'arcsec, Twinkle data sheet'),
    PublishedUnit('Blue Canyon NST', 'not stated', 6.0, 40.0, None, None, None,
                  'Blue Canyon Technologies, Nano Star Tracker data sheet'),
    PublishedUnit('Terma HE-5AS', 'not stated', 3.2, 16.0, None, None, None,
                  'Terma, HE-5AS data sheet'),
)

AURIGA_3_SIGMA_ARCSEC = {
    'field-of-view spatial error': (9.0, 51.0), 'pixel spatial error': (6.6, 38.0),
    'temporal noise': (11.0, 70.0)}
"""The rows of Auriga that a simulation has too: across and about the boresight."""

AURIGA_ACQUISITION_S, AURIGA_ACQUISITION_DEG_S, AURIGA_TRACKING_DEG_S = 3.8, 2.0, 3.0

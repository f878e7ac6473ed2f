# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rotations from other frames to ICRF, whose axes are those of GCRS."""

import erfa
import numpy as np
from startracker_ros.core.astro.constants import DAY_S
from startracker_ros.core.astro.earth import julian_date


def gcrs_from_itrf(year: float, ut1_utc_s: float = 0.0) -> np.ndarray:
    """
    Return the rotation (3, 3) from Earth-fixed to GCRS axes at a Julian year UTC.

    IAU 2006/2000A without polar motion, 0.5 arcsec at most (ERFA, c2t06a); UTC serves for TT in
    precession and nutation, which turn the axes by 0.0001 arcsec in the minute between them.
    """
    day, fraction = julian_date(year)
    return erfa.c2t06a(day, fraction, day, fraction + ut1_utc_s / DAY_S, 0.0, 0.0).T


def gcrs_from_j2000() -> np.ndarray:
    """Return the rotation (3, 3) from mean equator and equinox of J2000, the frame bias (bp06)."""
    return erfa.bp06(*julian_date(2000.0))[0].T


def gcrs_from_teme(year: float) -> np.ndarray:
    """
    Return the rotation (3, 3) from true equator, mean equinox of date to GCRS axes.

    IAU 2006/2000A precession and nutation (ERFA, pnm06a), less the equation of the equinoxes.
    """
    tt = julian_date(year)
    return np.array(erfa.pnm06a(*tt)).T @ erfa.rz(-erfa.ee06a(*tt), np.eye(3))

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Position, velocity and axes of the Earth, from the IAU SOFA library (ERFA)."""

import erfa
import numpy as np
from startracker_ros.core.astro.constants import (
    AU_M, DAY_S, DAYS_PER_YEAR, FIRST_YEAR, J2000_JD, LAST_YEAR)


class EpochError(ValueError):
    """An epoch for which the position of the Earth is not known; the text names it."""


def julian_date(year: float) -> tuple[float, float]:
    """Return a Julian year as a Julian date in two parts, which keeps the microseconds."""
    return J2000_JD, (year - 2000.0) * DAYS_PER_YEAR


def in_range(year: float) -> bool:
    """Return whether the series hold at a Julian year."""
    return FIRST_YEAR <= year <= LAST_YEAR


def earth_state(year: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return heliocentric and barycentric position (3,) in au and barycentric velocity (3,) in m/s.

    Of the centre of the Earth on ICRS axes at a Julian year TDB, for which UTC serves: in the
    minute between them the velocity changes by 0.4 m/s, 0.0003 arcsec of aberration. The errors
    are 13 km and 5 mm/s (ERFA, epv00: 1900 to 2100). EpochError outside these years.
    """
    if not in_range(year):
        raise EpochError(f'epoch J{year:.2f} is outside {FIRST_YEAR:.0f}-{LAST_YEAR:.0f}')
    heliocentric, barycentric = erfa.epv00(*julian_date(year))
    return (np.array(heliocentric['p']), np.array(barycentric['p']),
            np.array(barycentric['v']) * (AU_M / DAY_S))


def earth_velocity_m_s(year: float) -> np.ndarray:
    """Return the velocity (3,) of the Earth about the barycentre, as earth_state()."""
    return earth_state(year)[2]


def earth_position_au(year: float) -> np.ndarray:
    """
    Return the barycentric position (3,) of the Earth, from which stars have their parallax.

    It is that of the barycentre, zero, in years for which that of the Earth is not known.
    """
    return earth_state(year)[1] if in_range(year) else np.zeros(3)


# --- rotations from other frames to ICRF, whose axes are those of GCRS ---


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

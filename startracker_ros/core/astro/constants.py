# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Constants of astronomy, each with its source."""

SPEED_OF_LIGHT_M_S = 299_792_458.0
"""Exact by the definition of the metre."""

AU_M = 149_597_870_700.0
"""Astronomical unit (IAU 2012 resolution B2)."""

J2000_JD, UNIX_JD, MJD_JD = 2451545.0, 2440587.5, 2400000.5
"""Julian dates of J2000 and of the zeros of UNIX time and of the modified Julian date."""

DAY_S = 86400.0
DAYS_PER_YEAR = 365.25
"""Julian year."""
YEAR_S = DAYS_PER_YEAR * DAY_S
"""Julian year in s."""

FIRST_YEAR, LAST_YEAR = 1900.0, 2100.0
"""Years for which the series of the Earth hold (ERFA, epv00)."""

EARTH_MU_M3_S2 = 3.986004418e14
"""Gravitational parameter of the Earth with atmosphere (IERS Conventions 2010, table 1.1)."""

EARTH_RADIUS_M = 6378136.6
"""Equatorial radius of the Earth (IERS Conventions 2010, table 1.1)."""

EARTH_J2 = 1.0826359e-3
"""Dynamical form factor of the Earth (IERS Conventions 2010, table 1.1)."""

MAX_SPEED_M_S = 20e3
"""No orbit about the Earth is faster: 11.2 km/s is the speed of escape."""

"""Approximate positions of the planets and the Earth."""

import numpy as np

_OBLIQUITY = np.radians(23.43928)

# Standish, Keplerian elements for approximate positions of the major planets, table 1
# (ssd.jpl.nasa.gov/planets/approx_pos.html), 1800 to 2050: a [au], e, I, L, longitude of
# perihelion, longitude of the node [deg] at J2000 and their change in a century. The Earth,
# last, is the barycentre of Earth and Moon.
_AT_J2000 = np.array([
    [0.38709927, 0.20563593, 7.00497902, 252.25032350, 77.45779628, 48.33076593],
    [0.72333566, 0.00677672, 3.39467605, 181.97909950, 131.60246718, 76.67984255],
    [1.52371034, 0.09339410, 1.84969142, -4.55343205, -23.94362959, 49.55953891],
    [5.20288700, 0.04838624, 1.30439695, 34.39644051, 14.72847983, 100.47390909],
    [9.53667594, 0.05386179, 2.48599187, 49.95424423, 92.59887831, 113.66242448],
    [19.18916464, 0.04725744, 0.77263783, 313.23810451, 170.95427630, 74.01692503],
    [30.06992276, 0.00859048, 1.77004347, -55.12002969, 44.96476227, 131.78422574],
    [1.00000261, 0.01671123, -0.00001531, 100.46457166, 102.93768193, 0.0]])
_PER_CENTURY = np.array([
    [0.00000037, 0.00001906, -0.00594749, 149472.67411175, 0.16047689, -0.12534081],
    [0.00000390, -0.00004107, -0.00078890, 58517.81538729, 0.00268329, -0.27769418],
    [0.00001847, 0.00007882, -0.00813131, 19140.30268499, 0.44441088, -0.29257343],
    [-0.00011607, -0.00013253, -0.00183714, 3034.74612775, 0.21252668, 0.20469106],
    [-0.00125060, -0.00050991, 0.00193609, 1222.49362201, -0.41897216, -0.28867794],
    [-0.00196176, -0.00004397, -0.00242939, 428.48202785, 0.40805281, 0.04240589],
    [0.00026291, 0.00005105, 0.00035372, 218.45945325, -0.32241464, -0.00508664],
    [0.00000562, -0.00004392, -0.01294668, 35999.37244981, 0.32327364, 0.0]])


def heliocentric_au(year: float | np.ndarray) -> np.ndarray:
    """
    Return heliocentric positions (8, 3) on ICRF axes: Mercury to Neptune, then the Earth.

    year is a Julian year TDB, one for all or one for each (8,). Seen from the Sun the error is
    at most 75 arcsec for the inner planets and Mars, 15 arcmin for the others.
    """
    century = np.broadcast_to((np.asarray(year, float) - 2000) / 100, 8)
    a, e, inclination, mean, perihelion, node = (
        _AT_J2000 + _PER_CENTURY * century[:, None]).T
    inclination, mean, perihelion, node = np.radians([inclination, mean, perihelion, node])
    anomaly = np.remainder(mean - perihelion + np.pi, 2 * np.pi) - np.pi
    eccentric = anomaly + e * np.sin(anomaly)
    for _ in range(6):  # Newton's method for Kepler's equation
        eccentric -= ((eccentric - e * np.sin(eccentric) - anomaly)
                      / (1 - e * np.cos(eccentric)))
    x, y = a * (np.cos(eccentric) - e), a * np.sqrt(1 - e ** 2) * np.sin(eccentric)
    argument = perihelion - node
    # In the plane of the orbit: along the line of nodes and across it.
    along = x * np.cos(argument) - y * np.sin(argument)
    across = x * np.sin(argument) + y * np.cos(argument)
    ecliptic = np.stack([
        along * np.cos(node) - across * np.cos(inclination) * np.sin(node),
        along * np.sin(node) + across * np.cos(inclination) * np.cos(node),
        across * np.sin(inclination)])
    cos, sin = np.cos(_OBLIQUITY), np.sin(_OBLIQUITY)
    return (np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]) @ ecliptic).T

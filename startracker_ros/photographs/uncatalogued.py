# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Bright detections at whose position the catalogue has no star.

A planet of an image without a date, a comet, a nova, a satellite, a nebula, a lamp or a letter:
nothing here says which.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from startracker_ros.core.astro.earth import earth_position_au
from startracker_ros.core.catalog.deep import camera_catalog, DEEP_LIMIT
from startracker_ros.core.catalog.stars import load_catalog, StarCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.identify.identification import Identification
from startracker_ros.core.maths.rotation import matrix_from_quaternion, radec_from_unit
from startracker_ros.core.stages.bodies import BodyInImage
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.photographs.lens_fit import LensError

# Fewer stars have no zero point of the brightness.
_LEAST_STARS = 6
_HIPPARCOS_LIMIT = 7.3  # V, complete in all directions (ESA SP-1200, vol. 1)
_SIGMAS, _LEAST_SIGMA_MAG, _DOUBLE_MAG = 3.0, 0.1, 0.5
# A star so near is that of the detection, whose light may be that of a saturated star or of a
# double: in px and as a share of the width.
_NEAR_PX, _NEAR_SHARE = 8.0, 0.01
_SAME_PX = 3.0  # the centre of the flux of a spot from the centroid of its star
_SPOT_PX, _SHARPER = 2, 1.2  # half of the side of a spot; hot pixels than the sharpest star


class Uncatalogued(NamedTuple):
    """Pixel, right ascension and declination (ICRS), V by the stars of the image."""

    u: float
    v: float
    ra_deg: float
    dec_deg: float
    magnitude: float


def uncatalogued(image: np.ndarray, centroids: Centroids, found: Identification, sky: SkyMapping,
                 year: float, bodies: tuple[BodyInImage, ...], lens_error: LensError | None
                 ) -> tuple[Uncatalogued, ...]:
    """
    Return what an image (H, W) has without a catalogue star, planet, Moon or Sun, brightest first.

    Spots of any shape, saturated ones too, that are brighter than half of the identified stars,
    and than the catalogue is complete; none where too few stars are identified. Those that are
    sharper than all stars, or close together as the letters of a text, are left out, and those
    where the lens_error of a fitted lens may hide their star.
    """
    star = found.hip > 0
    if np.count_nonzero(star) < _LEAST_STARS:
        return ()
    spots = CentroidExtractor().find_spots(image, calm=True)
    if not len(spots):
        return ()
    distance, nearest = cKDTree(centroids.uv[star]).query(spots.uv)
    known = distance < _SAME_PX
    if np.count_nonzero(known) < _LEAST_STARS:
        return ()
    uv, camera = spots.uv, sky.camera
    by_flux = -2.5 * np.log10(np.maximum(spots.flux, np.finfo(float).tiny))
    zero_points = found.magnitude[star][nearest[known]] - by_flux[known]
    magnitude = by_flux + np.median(zero_points)
    sigma_mag = max(_LEAST_SIGMA_MAG, 1.4826 * float(np.median(
        np.abs(zero_points - np.median(zero_points)))))
    margin_mag = _SIGMAS * sigma_mag + _DOUBLE_MAG
    catalog = camera_catalog(camera)
    complete = _HIPPARCOS_LIMIT if len(catalog) == len(load_catalog()) else DEEP_LIMIT
    limit = min(complete - margin_mag, float(np.median(found.magnitude[star])))
    near_px = max(_NEAR_PX, _NEAR_SHARE * camera.width)
    bright = ~known & (magnitude < limit)
    if lens_error is not None:
        bright &= _SIGMAS * lens_error.sigma_px(uv) < near_px
    for body in bodies:
        bright &= np.hypot(*(uv - (body.u, body.v)).T) > body.radius_px + near_px
    rows = np.flatnonzero(bright)
    if not len(rows):
        return ()
    sharpest = _SHARPER * max(_sharpness(image, pixel) for pixel in uv[known])
    stars, star_magnitude = _stars(catalog, limit + margin_mag, sky, year)
    alone = [row for row in rows if _sharpness(image, uv[row]) < sharpest and not (
        (np.hypot(*(stars - uv[row]).T) < near_px)
        & (star_magnitude < magnitude[row] + margin_mag)).any()]
    ra, dec = radec_from_unit(sky.directions(uv[alone]))
    return tuple(sorted((
        Uncatalogued(*map(float, values)) for values in zip(
            *uv[alone].T, np.degrees(ra) % 360, np.degrees(dec), magnitude[alone])),
        key=lambda one: one.magnitude))


def _sharpness(image: np.ndarray, pixel: np.ndarray) -> float:
    """Return the share of the brightest pixel in the light of a spot at a pixel (2,)."""
    u, v = np.rint(pixel).astype(int)

    def around(radius: int) -> np.ndarray:
        return image[max(v - radius, 0):v + radius + 1,
                     max(u - radius, 0):u + radius + 1].astype(float)
    light = around(_SPOT_PX) - np.median(around(2 * _SPOT_PX + 1))
    return float(light.max() / max(light.sum(), light.max(), 1.0))


def _stars(catalog: StarCatalog, limit: float, sky: SkyMapping, year: float
           ) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (N, 2) and magnitudes (N,), of variables the brightest, of the stars seen."""
    brightest = catalog.magnitude - _SIGMAS * catalog.variation_mag
    catalog, brightest = catalog.rows(brightest < limit), brightest[brightest < limit]
    axis = matrix_from_quaternion(sky.quaternion)[:, 2]
    cos_dec = np.cos(catalog.dec_rad)
    cosine = (axis[0] * cos_dec * np.cos(catalog.ra_rad) + axis[1] * cos_dec
              * np.sin(catalog.ra_rad) + axis[2] * np.sin(catalog.dec_rad))
    # With some margin for proper motion.
    near = cosine > np.cos(min(sky.reach_rad + 0.01, np.pi))
    catalog, brightest = catalog.rows(near), brightest[near]
    uv = sky.pixels(catalog.directions(year, earth_position_au(year)))
    inside = np.isfinite(uv).all(axis=1)
    return uv[inside], brightest[inside]

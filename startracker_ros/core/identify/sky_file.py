# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The sky file of the native core: all that it knows of the sky, for one class of cameras.

Sections of a file of stored_arrays.py, read in place by native/src/sky/sky.h, which has what they
mean. Stars and their cells are those of camera_stars(). The pattern stars, the first ones of them,
and their pairs are those of PyramidIdentifier.
"""

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.star_file import cell_arrays, VERSION
from startracker_ros.core.identify.cache import camera_stars, PAIRS, STARS
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.pairs import PairDatabase
from startracker_ros.core.identify.pyramid import PyramidIdentifier


def sky_arrays(camera: Camera, epoch_year: float,
               options: IdentificationOptions = IdentificationOptions(),
               band: BandOptions = BandOptions()) -> dict[str, np.ndarray]:
    """
    Return the sections of the sky file for cameras of such pixels and field, by name.

    The places of the stars are those of the nearest whole year; directions at another time follow
    from their motion. CameraError for pixels so large that they show no stars.
    """
    stars = camera_stars(camera, round(epoch_year), band=band)
    identifier = PyramidIdentifier(camera, stars.epoch_year, options,
                                   PyramidIdentifier.catalog_for(camera, band))
    patterns = identifier.onboard.grid
    numbers = {
        'epoch_year': stars.epoch_year, 'pixel_rad': camera.pixel_rad,
        'crowd_rad': stars.crowd_rad, 'pattern_limit': identifier.magnitude_limit,
        'least_rad': identifier.least_rad, 'most_rad': identifier.most_rad}
    return {
        'sky': np.array(VERSION, np.int32),
        **{name: np.array(value, float) for name, value in numbers.items()},
        'band': np.frombuffer(band.band.encode(), np.uint8),
        **{name: getattr(stars, name) for name in STARS},
        **cell_arrays('', stars.grid), **cell_arrays('pattern_', patterns),
        **_pairs('pair_', identifier.pairs), **_pairs('bright_', identifier.bright_pairs)}


def _pairs(prefix: str, pairs: PairDatabase) -> dict[str, np.ndarray]:
    return {f'{prefix}{name}': getattr(pairs, name) for name in PAIRS}

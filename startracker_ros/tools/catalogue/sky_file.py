# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sky file of a camera, checked by the native core that reads it."""

from pathlib import Path

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.sky_file import sky_arrays
from startracker_ros.core.native import check_sky
from startracker_ros.core.stored_arrays import mapped_arrays, write_arrays
from startracker_ros.io.output import output_file
from startracker_ros.io.table import Result

# Where the sections of a part begin with another name, after the part that has the rest.
_PARTS = {'stars': '', 'pattern stars': 'pattern_', 'pairs': 'pair_',
          'pairs of the brightest': 'bright_'}
_COUNTED = {'stars': 'hip', 'pattern stars': 'pattern_member', 'pairs': 'pair_separation',
            'pairs of the brightest': 'bright_separation'}


def write_sky(camera: Camera, path: Path, epoch_year: float, options: IdentificationOptions,
              band: BandOptions) -> Result:
    """
    Write the sky file of a camera, and return what is in it.

    CameraError as of sky_arrays(); OutputError where it cannot be written.
    """
    arrays = sky_arrays(camera, epoch_year, options, band)
    with output_file(path) as file:
        write_arrays(file, arrays)
    check_sky(path)
    return contents(path)


def contents(path: Path) -> Result:
    """Return what is in a sky file; StoredArraysError for other files."""
    stored = mapped_arrays(path)
    arrays = stored.arrays
    part_of = {name: next((part for part, prefix in reversed(_PARTS.items())
                           if name.startswith(prefix)), '') for name in arrays}
    rows = [{'part': part, 'count': len(arrays[counted]), 'size_mb': 1e-6 * sum(
        array.nbytes for name, array in arrays.items() if part_of[name] == part)}
        for part, counted in _COUNTED.items()]
    return Result('sky', rows, {
        'file': str(path), 'size_mb': 1e-6 * stored.mapped_bytes,
        'epoch_year': float(arrays['epoch_year']), 'band': arrays['band'].tobytes().decode(),
        'faintest': float(arrays['magnitude'].max()),
        'faintest_pattern': float(arrays['pattern_limit']),
        'pairs_deg': f'{np.degrees(arrays["least_rad"]):.3g} .. '
                     f'{np.degrees(arrays["most_rad"]):.3g}',
        'pixel_arcsec': float(np.degrees(arrays['pixel_rad']) * 3600)})

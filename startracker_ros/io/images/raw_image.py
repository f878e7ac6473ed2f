# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of camera RAW files, read by rawpy (LibRaw)."""

import io

import numpy as np
from startracker_ros.core.extras import extra

SUFFIXES = ('.arw', '.cr2', '.cr3', '.dng', '.nef', '.orf', '.pef', '.raf', '.rw2', '.srw')


def read_raw(content: bytes, most_pixels: int) -> np.ndarray:
    """
    Return a RAW image (H, W) uint16 upright, linear, at half the resolution of the sensor.

    Each pixel is the mean of the colours of one 2 x 2 cell of the mosaic. ValueError for a file
    that LibRaw cannot read or with more pixels; MissingLibraryError without rawpy.
    """
    with extra('raw', 'rawpy', 'A camera RAW file'):
        import rawpy
    try:
        with rawpy.imread(io.BytesIO(content)) as raw:
            width, height = raw.sizes.width, raw.sizes.height
            if width * height > most_pixels:
                raise ValueError(f'{width} x {height} px, at most '
                                 f'{most_pixels // 1_000_000} million px are solved')
            colours = raw.postprocess(
                half_size=True, gamma=(1, 1), no_auto_bright=True, output_bps=16,
                user_wb=[1.0, 1.0, 1.0, 1.0], output_color=rawpy.ColorSpace.raw)
    except rawpy.LibRawError as error:
        raise ValueError(f'LibRaw cannot read it: {error}') from error
    return colours.mean(axis=2).round().astype(np.uint16)

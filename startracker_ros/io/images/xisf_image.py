# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Images of XISF files, the format of PixInsight.

XISF 1.0: the signature, the length of a header of XML, the header, blocks of data. The first Image
of the header names its block, compression and number type; its FITSKeyword elements are the cards
of a FITS header.
"""

from typing import Any
from xml.etree import ElementTree
import zlib

import lz4.block
import numpy as np
from startracker_ros.io.images.fits_image import described, FitsImage, one_plane
import zstandard

BEGIN = b'XISF0100'
_HEADER_AT, _LARGEST_HEADER_BYTES = 16, 20_000_000
_TYPES = {'UInt8': 'u1', 'UInt16': 'u2', 'UInt32': 'u4', 'Float32': 'f4', 'Float64': 'f8'}
_ERRORS = KeyError, ValueError, OverflowError, ElementTree.ParseError, zlib.error, RuntimeError


def read_xisf(content: bytes, most_pixels: int) -> FitsImage:
    """
    Return the first image of an XISF file: the mean of three channels, else the first of several.

    Its first row is the upper one. ValueError for a file without one, or with more pixels.
    """
    try:
        return _read(content, most_pixels)
    except (*_ERRORS, zstandard.ZstdError) as error:
        raise ValueError(f'not an XISF image that can be read: {error}') from error


def _read(content: bytes, most_pixels: int) -> FitsImage:
    length = int.from_bytes(content[8:12], 'little')
    header = content[_HEADER_AT:_HEADER_AT + length].rstrip(b'\0')
    if length > _LARGEST_HEADER_BYTES or b'<!DOCTYPE' in header or b'<!ENTITY' in header:
        raise ValueError('its header is not an XISF header')
    image = next((element for element in ElementTree.fromstring(header).iter()
                  if element.tag.endswith('Image') and 'geometry' in element.attrib), None)
    if image is None:
        raise ValueError('its header has no image')
    *sides, channels = map(int, image.attrib['geometry'].split(':'))
    if len(sides) != 2 or min(*sides, channels) < 1:
        raise ValueError(f'its geometry is {image.attrib["geometry"]}')
    width, height = sides
    if width * height * channels > most_pixels:
        raise ValueError(f'{width} x {height} px of {channels} channels, at most '
                         f'{most_pixels // 1_000_000} million px are solved')
    kind = image.attrib['sampleFormat']
    if kind not in _TYPES:
        raise ValueError(f'pixels of type {kind}, must be one of {", ".join(_TYPES)}')
    order = '>' if image.attrib.get('byteOrder') == 'big' else '<'
    dtype = np.dtype(order + _TYPES[kind])
    count = width * height * channels
    block = _block(content, image.attrib, count * dtype.itemsize)
    values = np.frombuffer(block, dtype, count).copy()
    planar = image.attrib.get('pixelStorage', 'Planar').lower() == 'planar'
    pixels = values.reshape((channels, height, width) if planar else (height, width, channels))
    cards = {element.attrib['name']: element.attrib.get('value', '').strip("' ")
             for element in image if element.tag.endswith('FITSKeyword')}
    return described(one_plane(pixels if planar else np.moveaxis(pixels, -1, 0)), cards,
                     bottom_up=False, order_known=True)


def _block(content: bytes, attributes: Any, size: int) -> bytes:
    """Return the data of an image, of so many bytes uncompressed."""
    kind, *place = attributes['location'].split(':')
    if kind != 'attachment':
        raise ValueError(f'its pixels are {kind}, must be an attachment')
    at, length = map(int, place)
    block = content[at:at + length]
    codec, *details = attributes.get('compression', 'none').split(':')
    if codec != 'none':
        name, shuffled, _ = codec.partition('+sh')
        if int(details[0]) != size:
            raise ValueError('the size of its pixels is not that of its geometry')
        block = _decompressed(name, block, size)
        if shuffled:
            block = _unshuffled(block, int(details[1]))
    if len(block) < size:
        raise ValueError('truncated')
    return block


def _decompressed(codec: str, block: bytes, size: int) -> bytes:
    if codec == 'zlib':
        return zlib.decompressobj().decompress(block, size)
    if codec in ('lz4', 'lz4hc'):
        return lz4.block.decompress(block, uncompressed_size=size)
    if codec == 'zstd':
        return zstandard.ZstdDecompressor().decompress(block, max_output_size=size)
    raise ValueError(f'its compression {codec} is not one of zlib, lz4, lz4hc, zstd')


def _unshuffled(block: bytes, item: int) -> bytes:
    """Return bytes that were sorted by their place in items of so many bytes."""
    count = len(block) // item
    planes = np.frombuffer(block, np.uint8, item * count).reshape(item, count)
    return planes.T.tobytes() + block[item * count:]

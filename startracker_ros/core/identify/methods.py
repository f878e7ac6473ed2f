# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The identification methods by name."""

from typing import Any

import numpy as np
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.identify.identification import IdentificationOptions, Identifier
from startracker_ros.core.options import Options
from startracker_ros.core.registry import METHODS

CLASSES: dict[str, type[Identifier]] = {name: method.load() for name, method in METHODS.items()}
"""All are imported: a node declares the options of each."""

OWN_OPTIONS: tuple[type[Options], ...] = tuple(
    kind.own_options for kind in CLASSES.values() if kind.own_options is not None)
"""The options that a method alone has."""

_WIDEST_RAD = np.radians(75.0)


def check_field(camera: Camera, method: str) -> None:
    """Raise CameraError for a method whose patterns are in a plane that the camera has not."""
    angle_rad = camera.corner_angle_rad
    if METHODS[method].in_a_plane and angle_rad > _WIDEST_RAD:
        raise CameraError(
            f'method {method} works in a plane: the corners of the image are '
            f'{np.degrees(angle_rad):.0f} deg from the optical axis, at most '
            f'{np.degrees(_WIDEST_RAD):.0f} are possible; set method to pyramid')


def make_identifier(camera: Camera, epoch_year: float,
                    options: IdentificationOptions = IdentificationOptions(),
                    catalog: StarCatalog | None = None, *, band: BandOptions = BandOptions(),
                    own: Options | None = None) -> Identifier:
    """
    Return an identifier of the method, its database built or cached; CameraError.

    Without a catalogue it is that of the method, with magnitudes in a band; own are options of
    its own_options.
    """
    check_field(camera, options.method)
    kind: Any = CLASSES[options.method]
    if catalog is None:
        catalog = kind.catalog_for(camera, band)
    made: Identifier = kind(camera, epoch_year, options, catalog, *([] if own is None else [own]))
    return made

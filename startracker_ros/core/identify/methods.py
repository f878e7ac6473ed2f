# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The identification methods by name."""

import numpy as np
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.catalog.stars import StarCatalog
from startracker_ros.core.identify.extended_grid import ExtendedGridIdentifier
from startracker_ros.core.identify.hausdorff import PivotIdentifier, SegmentIdentifier
from startracker_ros.core.identify.identification import IdentificationOptions, Identifier
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.identify.quad import QuadIdentifier

_METHODS: dict[str, type[Identifier]] = {
    'pyramid': PyramidIdentifier, 'quad': QuadIdentifier, 'hausdorff_pivot': PivotIdentifier,
    'hausdorff_segment': SegmentIdentifier, 'extended_grid': ExtendedGridIdentifier}

_IN_A_PLANE = 'hausdorff_pivot', 'hausdorff_segment', 'extended_grid'
_WIDEST_RAD = np.radians(75.0)


def check_field(camera: Camera, method: str) -> None:
    """Raise CameraError for a method whose patterns are in a plane that the camera has not."""
    angle_rad = camera.corner_angle_rad
    if method in _IN_A_PLANE and angle_rad > _WIDEST_RAD:
        raise CameraError(
            f'method {method} works in a plane: the corners of the image are '
            f'{np.degrees(angle_rad):.0f} deg from the optical axis, at most '
            f'{np.degrees(_WIDEST_RAD):.0f} are possible; set method to pyramid')


def make_identifier(camera: Camera, epoch_year: float,
                    options: IdentificationOptions = IdentificationOptions(),
                    catalog: StarCatalog | None = None) -> Identifier:
    """Return an identifier of the method, its database built or cached; CameraError."""
    check_field(camera, options.method)
    return _METHODS[options.method](camera, epoch_year, options, catalog)

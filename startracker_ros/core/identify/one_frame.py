# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stars of one frame of centroids, with its attitude in ICRF."""

from datetime import datetime
from functools import lru_cache
from typing import Any

from startracker_ros.core.astro.epoch import julian_year
from startracker_ros.core.astro.observer_motion import AT_REST, observer_at
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids, MADE_BY
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.identify.icrf import icrf_identification
from startracker_ros.core.identify.identification import (
    Identification, IdentificationOptions, Identifier)
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.options import options_by_class
from startracker_ros.core.values import of_type


def identify(centroids: Centroids, camera: Camera, *, epoch_year: float | datetime | str,
             method: str | type[Identifier] = 'pyramid', aberration: str = 'earth_only',
             **options: Any) -> Identification:
    """
    Identify the centroids of one frame; the attitude is that of the sensor in ICRF.

    The first call builds the pattern database of a camera; it is kept.

    Args:
        centroids: Detections of the frame, of `extract()` or made of a list.
        camera: Lens, its focal length known to `fov_error_percent`, 0.5 by default.
        epoch_year: Julian year, datetime or text as `'2026-07-02T12:00:00Z'`, UTC without a zone.
        method: Name of a method (pyramid, quad, ...), or a subclass of `CandidateIdentifier`.
        aberration: `'earth_only'`, for the velocity of the Earth, or `'none'`.
        **options: Parameters of the node star_identifier, as `magnitude_limit=6.0`.

    Returns:
        `Identification`; its `status` is 'identified', or its `reason` says why not.

    Raises:
        CameraError: A field of view that the method cannot handle.
        ValueError: A wrong argument or option, or candidates that the catalogue does not have.

    """
    of_type('centroids', centroids, Centroids, MADE_BY)
    epoch_year = julian_year(epoch_year, 'epoch_year')
    if aberration not in ('earth_only', 'none'):
        raise ValueError(f'aberration = {aberration!r} must be one of earth_only, none')
    named, kind = (method, None) if isinstance(method, str) else ('pyramid', method)
    values = options_by_class((IdentificationOptions,), {'method': named, **options})
    chosen = values[IdentificationOptions]
    assert isinstance(chosen, IdentificationOptions)
    identifier, onboard = _identifier(camera, epoch_year, chosen, kind)
    sky = ApparentCatalog(
        onboard, AT_REST if aberration == 'none' else observer_at(epoch_year, None))
    return icrf_identification(
        identifier.identify(centroids), centroids, camera, sky, chosen)


@lru_cache(maxsize=4)
def _identifier(camera: Camera, epoch_year: float, options: IdentificationOptions,
                kind: type[Identifier] | None) -> tuple[Identifier, OnboardCatalog]:
    return ((kind or make_identifier)(camera, epoch_year, options),
            camera_stars(camera, epoch_year))

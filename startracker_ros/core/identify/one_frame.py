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
    Return which catalogue star each centroid is, and the attitude of the sensor in ICRF.

    camera is known to fov_error_percent. method is a name, or a custom class as
    CandidateIdentifier. aberration is that of the Earth's velocity at the Julian
    year, or 'none' for a sky without. options are those of star_identifier, as they are in
    IdentificationOptions. The database of a camera is built by the first call and kept. ValueError
    for a wrong option, for other types than Centroids, and for a custom method with rows that the
    catalogue does not have; CameraError for a field that the method cannot handle.
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

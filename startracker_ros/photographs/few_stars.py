# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Identification of a few stars among many false spots, by all triangles of them.

native/src/blind/few_stars.h tells how, and how likely a wrong one agrees as well.
"""

from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.identify.identification import FieldStars, Identification, Identifier
from startracker_ros.core.identify.star_matcher import usable_stars
from startracker_ros.photographs.sky_triangles import TriangleTable


def few_stars(identifier: Identifier, table: TriangleTable, centroids: Centroids,
              sigma_floor_px: float, false_alarm_max: float, work_s: float
              ) -> tuple[Identification, float]:
    """
    Return the stars of the first triangle that is accepted by so much work, and what it took.

    Work is that of PyramidIdentifier.identify_within().
    """
    index, image, sigma = usable_stars(
        identifier.camera, centroids, identifier.options.max_image_stars, sigma_floor_px)
    match, spent_s = identifier.verifier.few_stars(
        image, sigma, table.native(), false_alarm_max, work_s)
    if match.false_alarm > false_alarm_max:
        status = 'time_limit' if spent_s > work_s else 'no_candidate'
        return identifier.unidentified(centroids, status, f'{len(index)} detections, no few of '
                                       'them are stars', match.false_alarm), spent_s
    return identifier.identified(
        centroids, FieldStars(index, image, sigma, centroids.flux[index]), match), spent_s


def image_area(camera: Camera) -> float:
    """Return the area of an image in rad^2, at the scale of its middle."""
    return camera.width * camera.height * camera.pixel_rad ** 2

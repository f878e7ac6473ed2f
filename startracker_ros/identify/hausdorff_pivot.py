"""The pivot approach: the pivots are stars, those of the image and those of the catalogue."""

import numpy as np
from startracker_ros.catalog.onboard import StarPlaces
from startracker_ros.identify.hausdorff import FOUR_OF_SIX, HausdorffIdentifier, Pivots
from startracker_ros.identify.identification import FieldStars


class PivotIdentifier(HausdorffIdentifier):
    """
    Sets of a star and four of its brightest neighbours.

    The paper wants a star at the centre of the field. Here every star of the image is a pivot,
    the one nearest to the centre first. An image misses part of what is around the outer
    ones: so sets are stored without any two of the six brightest neighbours, too, and again
    for the circle through the corners of the image, in which a poor field has more stars.
    """

    min_stars = 5
    sky_fours = FOUR_OF_SIX

    @property
    def search_radii_rad(self) -> list[float]:
        return [self.radius_rad, max(self.camera.corner_angle_rad, self.radius_rad)]

    def sky_pivots(self, places: StarPlaces) -> Pivots:
        return Pivots(places.direction, np.arange(len(places)))

    def image_pivots(self, field: FieldStars) -> Pivots:
        order = np.argsort(-(field.direction @ self.centre), kind='stable')
        return Pivots(field.direction[order], order)

"""The pivot approach of hausdorff.py: the pivots are stars of the image and the catalogue."""

import numpy as np
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.identify.hausdorff import FOUR_OF_SIX, HausdorffIdentifier, Pivots
from startracker_ros.core.identify.identification import FieldStars


class PivotIdentifier(HausdorffIdentifier):
    """
    Sets of a star and four of its brightest neighbours.

    The paper requires a star at the centre of the field. Here every star of the image is a pivot,
    the one nearest to the centre first. The image does not contain all neighbours of the outer
    ones: so sets without any two of the six brightest neighbours are stored, too, and again
    for the circle through the corners of the image, in which a sparse field has more stars.
    """

    min_stars = 5
    sky_fours = FOUR_OF_SIX

    @property
    def search_radii_rad(self) -> list[float]:
        return [self.radius_rad, max(self.camera.corner_angle_rad, self.radius_rad)]

    def sky_pivots(self, onboard: OnboardCatalog) -> Pivots:
        return Pivots(onboard.direction, np.arange(len(onboard)))

    def image_pivots(self, field: FieldStars) -> Pivots:
        order = np.argsort(-(field.direction @ self.centre), kind='stable')
        return Pivots(field.direction[order], order)

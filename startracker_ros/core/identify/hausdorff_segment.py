"""The segmentation approach of hausdorff.py: the pivots are nodes of a grid over the sky."""

import numpy as np
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.identify.hausdorff import HausdorffIdentifier, Pivots
from startracker_ros.core.identify.identification import FieldStars
from startracker_ros.core.maths.rotation import unit_from_radec

# Pivots along one side of a square about the centre of an image, and the share of the radius of
# the circle from one to the next: 1 deg in a field of 12 deg.
_SIDE, _SPACING = 5, 1 / 6


class SegmentIdentifier(HausdorffIdentifier):
    """
    Sets of a virtual pivot and the four brightest stars around it.

    The nodes are at every degree of right ascension, 0 to 360, and of declination: 361 x 181.
    The first meridian and the poles are repeated, as in the published counts. A node is
    somewhere near the centre of an image, so the image pivots are that centre and points around
    it: some of them have the same neighbours as a node.
    """

    min_stars = 4

    @property
    def pivot_error_rad(self) -> float:
        """Half the diagonal between nodes; the tangent plane is stretched towards its edge."""
        return np.radians(1.0) / np.sqrt(2) / np.cos(self.radius_rad) ** 2

    def sky_pivots(self, onboard: OnboardCatalog) -> Pivots:
        ra_deg, dec_deg = np.meshgrid(np.arange(361.0), np.arange(-90.0, 91.0))
        return Pivots(unit_from_radec(np.radians(ra_deg.ravel()), np.radians(dec_deg.ravel())))

    def image_pivots(self, field: FieldStars) -> Pivots:
        step = np.tan(self.radius_rad) * _SPACING
        steps = np.stack(np.meshgrid(*[np.arange(_SIDE) - _SIDE // 2] * 2), -1).reshape(-1, 2)
        steps = steps[np.argsort(np.hypot(*steps.T), kind='stable')]
        focal_px = np.array([self.camera.fx, self.camera.fy])
        return Pivots(self.camera.unproject(self.centre_px + steps * step * focal_px))

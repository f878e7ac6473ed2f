"""Centroids as marks over the image, for viewers that draw them themselves."""

from geometry_msgs.msg import Point
import numpy as np
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import ImageMarker

# Two ticks, right of the star and below it, leave the star itself free.
TICKS_PX = np.array([(6.0, 0.0), (14.0, 0.0), (0.0, 6.0), (0.0, 14.0)])
_COLOUR = ColorRGBA(r=1.0, g=0.75, b=0.25, a=1.0)


def centroids_to_image_marker(uv: np.ndarray, header: Header) -> ImageMarker:
    """Return `image_markers`, a reticle at each pixel uv (N, 2); each replaces the last one."""
    ends = (uv[:, None] + TICKS_PX).reshape(-1, 2).tolist()
    return ImageMarker(
        header=header, ns='centroids', type=ImageMarker.LINE_LIST, action=ImageMarker.ADD,
        scale=1.5, outline_color=_COLOUR, points=[Point(x=u, y=v) for u, v in ends])

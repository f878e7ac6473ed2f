# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Centroids as marks over the image, for viewers that draw them themselves."""

from geometry_msgs.msg import Point
import numpy as np
from startracker_ros.core.stages.annotate import RETICLE_TICKS_PX
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import ImageMarker

_COLOUR = ColorRGBA(r=1.0, g=0.75, b=0.25, a=1.0)


def centroids_to_image_marker(uv: np.ndarray, header: Header) -> ImageMarker:
    """Return `image_markers`, a reticle at each pixel uv (N, 2); each replaces the last one."""
    ends = (uv[:, None] + RETICLE_TICKS_PX).reshape(-1, 2).tolist()
    return ImageMarker(
        header=header, ns='centroids', type=ImageMarker.LINE_LIST, action=ImageMarker.ADD,
        scale=1.5, outline_color=_COLOUR, points=[Point(x=u, y=v) for u, v in ends])

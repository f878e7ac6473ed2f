"""Attitude of one star image, without ROS."""

import numpy as np
from startracker_ros.camera.model import Camera
from startracker_ros.centroid.extraction import CentroidExtractor
from startracker_ros.identify.methods import make_identifier


def solve_image(image: np.ndarray, fov_deg: float, epoch_year: float) -> np.ndarray:
    height, width = image.shape  # uint8 or uint16
    identifier = make_identifier(Camera.from_fov(width, height, fov_deg), epoch_year)
    identification = identifier.identify(CentroidExtractor().extract(image).centroids)
    if identification.attitude is None:
        raise ValueError(identification.reason)
    return identification.attitude.quaternion  # q_icrf_from_sensor: x, y, z, w

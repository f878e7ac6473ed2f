# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The lens of a camera that nobody has calibrated, by the first of its images that is solved."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.stages.photograph import PhotographSolver
from startracker_ros.io.images.capture import Device

# The false-alarm probability holds for one image; here many are tried.
_LEAST_MATCHED = 8
_OPTIONS = IdentificationOptions(fov_error_percent=5.0)


class FirstLens(NamedTuple):
    """A camera, and the 1-sigma error per axis in px that its lens leaves in a star's pixel."""

    camera: Camera
    error_px: float


def first_lens(device: Device, fov_deg: float | None,
               on_image: Callable[[np.ndarray, np.ndarray, str], None]) -> FirstLens | None:
    """
    Return the lens of the first image of a device that is solved, None when its images end.

    fov_deg is the horizontal field of view to 5 %, None where it is unknown. on_image receives
    each image (H, W), its spots (N, 2) and why it is not solved, empty if it is.
    """
    solver = None
    while (captured := device.read()) is not None:
        image = captured.image
        if solver is None:
            height, width = image.shape
            camera = None if fov_deg is None else Camera.from_fov(width, height, fov_deg)
            solver = PhotographSolver(epoch_year_from_stamp(captured.stamp_ns), _OPTIONS)
        solution = solver.solve(image, camera)
        found = solution.identification
        solved = solution.sky is not None and found.matched >= _LEAST_MATCHED
        few = f'{found.matched} stars, {_LEAST_MATCHED} are needed for a lens'
        on_image(image, solution.centroids.uv,
                 '' if solved else found.reason if solution.sky is None else few)
        if solved:
            return FirstLens(solution.camera, solution.lens_px)
    return None

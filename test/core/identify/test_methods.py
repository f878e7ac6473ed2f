# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which methods a camera can have."""

import pytest
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.methods import check_field
from startracker_ros.core.registry import METHODS
from startracker_ros.core.stages.identification import IdentificationStage

FISHEYE = Camera.from_fov(1024, 768, 155.0, 'equidistant')
IN_A_PLANE = {'hausdorff_pivot', 'hausdorff_segment', 'extended_grid'}


@pytest.mark.parametrize('method', METHODS)
def test_a_fisheye_needs_a_method_on_the_sphere(method):
    check_field(Camera.from_fov(1024, 768, 70.0), method)
    check_field(Camera.from_fov(1024, 768, 70.0, 'equidistant'), method)
    if method in IN_A_PLANE:
        with pytest.raises(CameraError, match=f'{method} works in a plane.*pyramid'):
            IdentificationStage(FISHEYE, 2026.0, IdentificationOptions(method=method))
    else:
        check_field(FISHEYE, method)

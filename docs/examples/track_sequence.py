# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitude of a sequence of images, here simulated ones, without ROS."""

import numpy as np
import startracker_ros as st

START_NS, STEP_NS = 1_782_864_000_000_000_000, 100_000_000  # in July 2026, at 10 Hz

camera = st.Camera.from_fov(512, 512, 12.0)
sky = st.SkySimulator(camera, 2026.5, motion='constant_rate', rate_deg_s=(0.1, 0.0, 0.0),
                      aberration=False)
tracker = st.StarTracker(camera, 2026.5, aberration='none', max_stars=30)
for index in range(8):
    image = sky.frame(index / 10).image
    result = tracker.process(START_NS + index * STEP_NS, image)
    if result.attitude is None:
        print(f'{result.state}: {result.reason}')
    else:
        sigma_arcsec = np.degrees(np.sqrt(np.diag(result.attitude.covariance_sensor))) * 3600
        print(f'{result.state}: {result.attitude.quaternion.round(6)}, '
              f'1 sigma {sigma_arcsec.round(1)} arcsec')

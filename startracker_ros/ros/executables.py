# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The nodes and their modules: the one list that setup.py, the command line and launch share."""

NODES = {name: f'startracker_ros.ros.nodes.{name}' for name in (
    'sky_simulator',
    'image_publisher',
    'camera_source',
    'exposure_controller',
    'centroid_extractor',
    'star_identifier',
    'star_tracker',
    'attitude_estimator',
    'attitude_fusion',
    'target_locator',
    'camera_calibrator',
    'telemetry_bridge',
    'bag_recorder',
    'bag_player',
    'pipeline_manager',
)}

EXECUTABLES = {**NODES, 'composed_pipeline': 'startracker_ros.ros.composed_pipeline'}
"""All that `ros2 run` finds: the nodes, and what runs several of them in one process."""

WRONG_USE = 2
"""
Exit status of a node that cannot run as requested: a wrong parameter or argument, a library that
is missing or too old. To start it again does not help (launch, startracker.service).
"""

STAGES = ('centroid_extractor', 'star_identifier', 'star_tracker', 'attitude_estimator')
"""The nodes between images and attitude."""

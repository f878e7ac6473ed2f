# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Star tracker on a recording: pipeline.launch.py, and bag_player with its inputs.

`bag:=folder` names the bag. Only images, camera_info, exposure_start, imu and odometry are
played, once the pipeline is ready: it publishes the other topics again. A bag without a namespace
is played into `namespace:=...`; topics that were recorded in a namespace keep it, so name the same
one. The launch ends with the bag.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown, TimerAction
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.launching import declared, node, pipeline, shared_arguments

TOPICS = ('image_raw', 'image_raw/compressed', 'camera_info', 'exposure_start', 'imu',
          'odometry')
# The first run on a machine compiles.
WAIT_LIMIT_S = 300.0
# Ten seconds of a camera of 10 Hz: on a busy machine the extractor may be late by seconds. A live
# pipeline has a shorter queue to stay current.
IMAGE_DEPTH = '100'
# For the stages to process the last images.
END_S = 5.0


def generate_launch_description() -> LaunchDescription:
    """Return the pipeline and the bag player."""
    shared = shared_arguments()
    return LaunchDescription([
        *declared([
            *shared,
            DeclareLaunchArgument(
                'bag', default_value='bag', description='bag folder or .mcap file'),
            DeclareLaunchArgument(
                'rate', default_value='', description='times as fast as recorded'),
            DeclareLaunchArgument(
                'loop', default_value='', description='true: begin again after the end'),
            DeclareLaunchArgument(
                'start_offset', default_value='',
                description='recorded seconds left out at the beginning')]),
        pipeline(shared, image_depth=IMAGE_DEPTH),
        node('bag_player', name='bag_player',
             arguments={'path': ('bag', str), 'rate': ('rate', float), 'loop': ('loop', bool),
                        'start_offset_s': ('start_offset', float)},
             parameters={'topics': [f'*/{topic}' for topic in TOPICS],
                         'wait_for_camera_users': len(STAGES), 'wait_limit_s': WAIT_LIMIT_S},
             # To the relative name, which is in the namespace of the node.
             remappings=[(f'/{topic}', topic) for topic in TOPICS],
             on_exit=[TimerAction(period=END_S, actions=[Shutdown()])]),
    ])

"""
Star tracker for a camera: image_raw and camera_info of its namespace -> attitude.

pipeline_manager configures and activates the stages. A stage whose process has ended is started
again, and the manager brings it up again.

For your own camera copy the parameter files, change them and pass their folder as
`config:=...`, or write what differs into one file and pass it as `params_file:=...`. Focal length
and distortion come from the camera_info of the camera.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from startracker_ros.executables import STAGES
from startracker_ros.harness.launching import node, RESPAWN, shared_arguments

LISTS = ('centroids', 'stars', 'tracks', 'tracked_attitude')


def queue_depth(topic: str, end: str, argument: str) -> dict:
    """Return the parameter that sets the depth of the publisher or subscription of a topic."""
    # Its name contains that of the topic.
    name = PathJoinSubstitution(['/', LaunchConfiguration('namespace'), topic])
    return {('qos_overrides.', name, f'.{end}.depth'): LaunchConfiguration(argument)}


def generate_launch_description() -> LaunchDescription:
    """Return the four stages of the star tracker and, on request, the recorder."""
    composed = LaunchConfiguration('composed')
    managed = {'autostart': False}
    depths = [queue_depth('image_raw', 'subscription', 'image_depth'),
              *(queue_depth(topic, end, 'list_depth')
                for topic in LISTS for end in ('publisher', 'subscription'))]
    return LaunchDescription([
        *shared_arguments(),
        DeclareLaunchArgument(
            'record', default_value='false', description='record all topics into a bag'),
        DeclareLaunchArgument(
            'image_depth', default_value='2', description='images that centroid_extractor may '
            'have in its queue'),
        DeclareLaunchArgument(
            'list_depth', default_value='10', description='frames that each following stage may '
            'have in its queues'),
        node('bag_recorder', name='bag_recorder',
             condition=IfCondition(LaunchConfiguration('record'))),
        *(node(name, name=name, condition=UnlessCondition(composed), **RESPAWN,
               parameters=[managed, *depths])
          for name in STAGES),
        # Without a name: it would rename all nodes of the process.
        node('composed_pipeline', files=STAGES, condition=IfCondition(composed), **RESPAWN,
             parameters=[managed, *depths]),
        node('pipeline_manager', name='pipeline_manager', **RESPAWN,
             condition=IfCondition(LaunchConfiguration('manager'))),
    ])

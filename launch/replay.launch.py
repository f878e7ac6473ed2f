"""
Star tracker on a recording: pipeline.launch.py, and bag_player with images and rates.

`bag:=folder` names the bag. Only images, camera_info and imu are played: the pipeline publishes
the other topics again. A bag without a namespace is played into `namespace:=...`; topics that
were recorded in a namespace keep it, so name the same one.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from startracker_ros.harness.launching import node, pipeline, shared_arguments

TOPICS = ('image_raw', 'camera_info', 'imu')


def generate_launch_description() -> LaunchDescription:
    """Return the pipeline and the bag player."""
    shared = shared_arguments()
    return LaunchDescription([
        *shared,
        DeclareLaunchArgument('bag', default_value='bag', description='bag folder or .mcap file'),
        pipeline(shared),
        node('bag_player', name='bag_player',
             parameters=[{'path': LaunchConfiguration('bag'),
                          'topics': [f'*/{topic}' for topic in TOPICS]}],
             # To the relative name, which is in the namespace of the node.
             remappings=[(f'/{topic}', topic) for topic in TOPICS]),
    ])

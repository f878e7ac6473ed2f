"""Names of the coordinate frames."""

from dataclasses import dataclass

from startracker_ros.options import option, Options


@dataclass(frozen=True)
class InertialFrameOptions(Options):
    """The inertial frame in message headers."""

    inertial_frame_id: str = option('icrf', 'inertial frame of attitudes and odometry')


@dataclass(frozen=True)
class FrameOptions(InertialFrameOptions):
    """Frame names in message headers."""

    sensor_frame_id: str = option(
        'star_tracker_optical_frame', 'optical frame of the camera: x right, y down, z boresight')

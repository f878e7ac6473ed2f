# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Options of the fusion."""

from dataclasses import dataclass

from startracker_ros.core.options import option, Options

NO_ROTATION = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class HeadsOptions(Options):
    """The heads and their mounts."""

    heads: tuple[str, ...] = option(
        ('tracker_1', 'tracker_2'), 'namespaces of the star trackers; the mount of the first '
        'defines the body', read_only=True)
    head_topic: str = option(
        'frame_attitude', 'attitude of each head: frame_attitude, whose frames are independent, '
        'or one that its tracker has filtered, with correlation_s',
        choices=('frame_attitude', 'attitude_imu', 'tracked_attitude'), read_only=True)
    mounts_file: str = option(
        '', 'YAML file with the mounts of the heads; only one head needs none', read_only=True)
    output_file: str = option(
        'mounts.yaml', 'file that ~/save_mounts writes, to be used as mounts_file',
        read_only=True)
    imu_quaternion: tuple[float, ...] = option(
        NO_ROTATION, 'rotation body from imu in the order x, y, z, w: v_body = R(q) v_imu',
        low=-1.0, high=1.0, read_only=True)


@dataclass(frozen=True)
class FusionOptions(Options):
    """When heads agree, how many have to, and how the body moves between frames."""

    start_heads: int = option(
        2, 'heads that must agree before there is an attitude; of a single head its own is '
        'enough', low=1, high=2)
    agree_frames: int = option(
        5, 'frames in a row with which a head that was excluded or silent has to agree before it '
        'counts again', unit='frames', low=1, high=10000)
    exclude_frames: int = option(
        3, 'frames in a row that disagree after which a head is excluded; a single one is left '
        'out', unit='frames', low=1, high=100)
    horizon_s: float = option(
        1.0, 'how late a frame may come, in stamps: later ones are not used', unit='s', low=0.0,
        high=60.0)
    max_gap_s: float = option(
        1.0, 'longest time without frames that is bridged without a gyro', unit='s', low=0.01,
        high=60.0)
    max_gyro_gap_s: float = option(
        600.0, 'longest time without frames that is bridged by a gyro', unit='s', low=0.01,
        high=1e5)
    acceleration_deg_s2: float = option(
        0.005, 'least process noise, 1 sigma of an angular acceleration that lasts for 0.1 s, '
        'with and without a gyro; more is estimated from the heads', unit='deg/s^2', low=1e-6,
        high=100.0)
    correlation_s: float = option(
        0.0, 'time over which the errors of the frames of one head are correlated: 0 for '
        'frame_attitude, whose frames are independent; attitudes that a tracker has filtered '
        'count less by this', unit='s', low=0.0, high=3600.0)

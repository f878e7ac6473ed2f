# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names of the coordinate frames."""

from dataclasses import dataclass

from startracker_ros.core.options import option, Options
from startracker_ros.io.bags.layouts import INERTIAL_FRAME_ID, SENSOR_FRAME_ID


@dataclass(frozen=True)
class InertialFrameOptions(Options):
    """The inertial frame in message headers."""

    inertial_frame_id: str = option(
        INERTIAL_FRAME_ID, 'inertial frame of attitudes and odometry')


@dataclass(frozen=True)
class ExtraFrameOptions(Options):
    """The attitude in other frames than ICRF."""

    publish_frames: bool = option(
        False, 'publish the attitude also with respect to the mean equator and equinox of J2000 '
        '(attitude_j2000), the Earth (attitude_itrf) and, with odometry, the orbit frame '
        '(attitude_orbit)', live=True)
    ut1_utc_s: float = option(
        0.0, 'UT1 - UTC of the day for attitude_itrf, from IERS Bulletin A; each 0.1 s turn it by '
        '1.5 arcsec', unit='s', low=-1.0, high=1.0, live=True)


@dataclass(frozen=True)
class FrameOptions(InertialFrameOptions):
    """Frame names in message headers of a camera."""

    sensor_frame_id: str = option(
        SENSOR_FRAME_ID, 'optical frame of the camera: x right, y down, z boresight')


@dataclass(frozen=True)
class AttitudeFrameOptions(InertialFrameOptions):
    """Frame names in message headers of an attitude."""

    sensor_frame_id: str = option(
        '', 'optical frame of the camera, x right, y down, z boresight, in the messages of the '
        'attitude; empty: frame_id of the images')

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Quality of service of every topic; each endpoint can be overridden by parameters."""

from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.exceptions import ParameterException
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from startracker_ros.ros.parameters import ParameterError

# Reliable on both sides: on the stock transport best effort loses most large images. For a
# camera driver that publishes best effort set qos_overrides./image_raw.subscription.reliability.
# The depths hold ten seconds of lists and a second of images of a camera of 10 Hz while a stage
# is late: the backlog is processed at full speed, and no frame is skipped.
IMAGE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
LIST = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
# Holds a second of a fast gyro while a node processes a frame, on both sides: what was measured
# between two frames may be published at once.
IMU = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
STATE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                   durability=DurabilityPolicy.TRANSIENT_LOCAL)
# As the broadcasters of tf2; /tf_static is as STATE.
TF = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


@contextmanager
def named_errors(end: str, topic: str) -> Iterator[None]:
    """Turn the error of an override that cannot be met into a ParameterError that names it."""
    try:
        yield
    except (RuntimeError, ValueError, ParameterException) as error:
        raise ParameterError(f'qos_overrides of the {end} of {topic}: {error}') from error


def overridable() -> QoSOverridingOptions:
    """Return options that let parameters change history, depth and reliability."""
    return QoSOverridingOptions.with_default_policies()

"""Quality of service of every topic; each endpoint can be overridden by parameters."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

# Reliable on both sides: with large frames best effort loses most of them on the
# stock transport. A foreign camera that offers best effort is taken by setting
# qos_overrides./image_raw.subscription.reliability.
IMAGE = QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)
LIST = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# A second of a fast gyro waits here while a node works on a frame.
IMU = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
STATE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                   durability=DurabilityPolicy.TRANSIENT_LOCAL)


def overridable() -> QoSOverridingOptions:
    """Return options that let parameters change history, depth and reliability."""
    return QoSOverridingOptions.with_default_policies()

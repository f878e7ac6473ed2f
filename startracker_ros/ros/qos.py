"""Quality of service of every topic; each endpoint can be overridden by parameters."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

# Reliable on both sides: on the stock transport best effort loses most large images. For a
# camera driver that publishes best effort set qos_overrides./image_raw.subscription.reliability.
IMAGE = QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)
LIST = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# Holds a second of a fast gyro while a node processes a frame.
IMU = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
STATE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                   durability=DurabilityPolicy.TRANSIENT_LOCAL)
# As the broadcasters of tf2; /tf_static is as STATE.
TF = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


def overridable() -> QoSOverridingOptions:
    """Return options that let parameters change history, depth and reliability."""
    return QoSOverridingOptions.with_default_policies()

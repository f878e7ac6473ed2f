# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages of every type that is recorded, serialized by an independent library."""

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

STAMP_NS = 1_700_000_000_123_456_789


@pytest.fixture(scope='session')
def store() -> Typestore:
    """Return the message types of Jazzy as rosbags knows them."""
    return get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(scope='session')
def samples(store: Typestore) -> dict[str, bytes]:
    """Return a serialized message of each type that is recorded, by the name of the type."""
    def make(name: str, *fields: object) -> object:
        package, short = name.split('/')
        return store.types[f'{package}/msg/{short}'](*fields)

    rng = np.random.default_rng(7)
    stamp = make('builtin_interfaces/Time', *divmod(STAMP_NS, 10 ** 9))
    header = make('std_msgs/Header', stamp, 'star_tracker_optical_frame')
    quaternion = make('geometry_msgs/Quaternion', 0.1, -0.2, 0.3, 0.9)
    vector = make('geometry_msgs/Vector3', 1.0, -2.0, 3.0)
    pose = make('geometry_msgs/PoseWithCovariance',
                make('geometry_msgs/Pose', make('geometry_msgs/Point', 1.0, 2.0, 3.0), quaternion),
                rng.normal(size=36))
    twist = make('geometry_msgs/TwistWithCovariance',
                 make('geometry_msgs/Twist', vector, vector), rng.normal(size=36))
    field = make('sensor_msgs/PointField', 'u', 0, 7, 1)
    status = make('diagnostic_msgs/DiagnosticStatus', 0, 'star_tracker: tracking', 'TRACKING',
                  'st0', [make('diagnostic_msgs/KeyValue', 'residual px', '0.1')])
    messages = [
        make('sensor_msgs/Image', header, 32, 48, 'mono16', 0, 96,
             rng.integers(0, 256, 32 * 96, np.uint8)),
        make('sensor_msgs/CameraInfo', header, 32, 48, 'plumb_bob', np.zeros(5),
             rng.normal(size=9), np.eye(3).ravel(), rng.normal(size=12), 0, 0,
             make('sensor_msgs/RegionOfInterest', 0, 0, 0, 0, False)),
        make('sensor_msgs/Imu', header, quaternion, rng.normal(size=9), vector,
             rng.normal(size=9), vector, rng.normal(size=9)),
        make('sensor_msgs/PointCloud2', header, 1, 5, [field], False, 4, 20,
             rng.integers(0, 256, 20, np.uint8), True),
        make('geometry_msgs/QuaternionStamped', header, quaternion),
        make('geometry_msgs/PoseWithCovarianceStamped', header, pose),
        make('geometry_msgs/TransformStamped', header, 'icrf',
             make('geometry_msgs/Transform', vector, quaternion)),
        make('nav_msgs/Odometry', header, 'sensor', pose, twist),
        status,
        make('diagnostic_msgs/DiagnosticArray', header, [status, status]),
        make('rosgraph_msgs/Clock', stamp),
    ]
    return {message.__msgtype__: bytes(store.serialize_cdr(message, message.__msgtype__))
            for message in messages}

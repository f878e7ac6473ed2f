# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Find the delay of a camera behind a gyro: python check_delay.py BAG [ATTITUDE_TOPIC IMU_TOPIC].

BAG is a folder of MCAP files, as `startracker record` and rosbag2 write them.

The turn between two frames by the stars is compared with the turn by the gyro between the same
times, moved by the delay. The delay and the bias of the gyro are those of least squares.
"""

from pathlib import Path
import sys

from mcap_ros2.reader import read_ros2_messages
import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


def read(bag: str, topic: str, values) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (N,) in ns and values of the messages that have some."""
    found = {}
    for path in Path(bag).glob('*.mcap'):
        for record in read_ros2_messages(path, topics=[topic]):
            stamp, value = record.ros_msg.header.stamp, values(record.ros_msg)
            if value is not None:
                found[stamp.sec * 10 ** 9 + stamp.nanosec] = value
    if not found:
        sys.exit(f'{bag}: no MCAP file with {topic}')
    stamps_ns = np.array(sorted(found))
    return stamps_ns, np.array([found[stamp_ns] for stamp_ns in stamps_ns])


def attitude(message):
    q = message.orientation
    return None if message.orientation_covariance[0] < 0 else [q.x, q.y, q.z, q.w]


def rate(message):
    w = message.angular_velocity
    return [w.x, w.y, w.z]


def fit(attitudes, rates) -> tuple[float, float]:
    """Return the delay of the attitudes behind the rates and its 1 sigma, s."""
    (stamps_ns, quaternions), (rate_stamps_ns, rates_rad_s) = attitudes, rates
    times_s, rate_times_s = ((each - stamps_ns[0]) * 1e-9 for each in (stamps_ns, rate_stamps_ns))
    turns = Rotation.from_quat(quaternions)
    by_stars = (turns[:-1].inv() * turns[1:]).as_rotvec() / np.diff(times_s)[:, None]
    # A rate is the mean since the one before: its integral is known at the stamps.
    steps_s = np.diff(rate_times_s, prepend=2 * rate_times_s[0] - rate_times_s[1])
    angle = make_interp_spline(rate_times_s, np.cumsum(rates_rad_s * steps_s[:, None], axis=0))

    def errors(parameters):
        delay_s, bias = parameters[0], parameters[1:]
        moved_s = np.clip(times_s - delay_s, rate_times_s[0], rate_times_s[-1])
        spans_s = np.diff(moved_s)[:, None]
        inside = spans_s[:, 0] > 0
        by_gyro = np.diff(angle(moved_s), axis=0)[inside] / spans_s[inside] - bias
        return (by_gyro - by_stars[inside]).ravel()
    fitted = least_squares(lambda p: errors(p), np.zeros(4), x_scale=[1e-2, 1e-3, 1e-3, 1e-3])
    residuals = fitted.fun
    variance = residuals @ residuals / max(1, len(residuals) - 4)
    covariance = np.linalg.pinv(fitted.jac.T @ fitted.jac) * variance
    # Noise of the gyro has a shape as well, which fits anything a little.
    moved = np.var(by_stars, axis=0).sum() > 10 * 3 * variance
    return fitted.x[0], float(np.sqrt(covariance[0, 0])) if moved else np.inf


if __name__ == '__main__':
    topics = sys.argv[2:4] or ['/attitude_imu', '/imu']
    delay_s, sigma_s = fit(read(sys.argv[1], topics[0], attitude),
                           read(sys.argv[1], topics[1], rate))
    if sigma_s > 0.01:
        sys.exit('not determined: the rate has to change, turn the camera to and fro')
    print(f'the camera is {delay_s * 1e3:+.2f} ms behind the gyro, 1 sigma {sigma_s * 1e3:.2f} ms')

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Find the delay of a camera behind a gyro: python check_delay.py BAG [ATTITUDE_TOPIC IMU_TOPIC].

The turn between two frames by the stars is compared with the turn by the gyro between the same
times, moved by the delay. The delay and the bias of the gyro are those of least squares.
"""

import sys

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from startracker_ros.io.bags.reader import read_messages


def read(bag: str, topic: str, values) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (N,) in s and values of the messages that have some."""
    found = {}
    for record in read_messages(bag, topics=(topic,)):
        message = record.decoded()
        value = values(message)
        if value is not None:
            found[message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec] = value
    stamps_ns = np.array(sorted(found))
    return (stamps_ns - ORIGIN_NS) * 1e-9, np.array([found[stamp_ns] for stamp_ns in stamps_ns])


def attitude(message):
    q = message.orientation
    return None if message.orientation_covariance[0] < 0 else [q.x, q.y, q.z, q.w]


def rate(message):
    w = message.angular_velocity
    return [w.x, w.y, w.z]


def fit(attitudes, rates) -> tuple[float, float]:
    """Return the delay of the attitudes behind the rates and its 1 sigma, s."""
    (times_s, quaternions), (rate_times_s, rates_rad_s) = attitudes, rates
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
    ORIGIN_NS = next(iter(read_messages(sys.argv[1]))).log_time_ns
    topics = sys.argv[2:4] or ['/attitude_imu', '/imu']
    delay_s, sigma_s = fit(read(sys.argv[1], topics[0], attitude),
                           read(sys.argv[1], topics[1], rate))
    if sigma_s > 0.01:
        sys.exit('not determined: the rate has to change, turn the camera to and fro')
    print(f'the camera is {delay_s * 1e3:+.2f} ms behind the gyro, 1 sigma {sigma_s * 1e3:.2f} ms')

# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Attitudes and rates as the messages of Basilisk, and back.

Basilisk names B the body and N the inertial axes. Its Euler parameters are w, x, y, z of the same
rotation as ours: EP2C() makes [BN] = R(q_icrf_from_body)^T of them. sigma_BN are the modified
Rodrigues parameters of [BN] (Schaub and Junkins, Analytical Mechanics of Space Systems, 3.5).
"""

from typing import Any

import numpy as np
from startracker_evaluation.extras import install_hint
from startracker_ros.core.extras import MissingLibraryError


class MeasurementError(ValueError):
    """An attitude or a rate that no message can contain; the text says why."""


def import_basilisk() -> None:
    """Import Basilisk; MissingLibraryError names the extra that installs it."""
    try:
        import Basilisk  # noqa: F401
    except ImportError as error:
        raise MissingLibraryError(
            f'The closed loop needs Basilisk: {install_hint("gnc")}') from error


def mrp_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Return sigma_BN (3,), length at most 1, of q_icrf_from_body (4,): v / (1 + w)."""
    q = _unit(q)
    q = -q if q[3] < 0 else q
    return q[:3] / (1 + q[3])


def quaternion_from_mrp(sigma: np.ndarray) -> np.ndarray:
    """Return q_icrf_from_body (4,), w >= 0, of sigma_BN (3,) of any length."""
    sigma = _finite(sigma, 'sigma_BN', 3)
    square = sigma @ sigma
    q = np.append(2 * sigma, 1 - square) / (1 + square)
    return -q if q[3] < 0 else q


def star_tracker_payload(time_ns: int, q_icrf_from_sensor: np.ndarray) -> Any:
    """
    Return the STSensorMsgPayload of an attitude.

    qInrtl2Case are the Euler parameters, w first, of the matrix from N to the case, our sensor
    frame; timeTag is in ns of the simulation.
    """
    from Basilisk.architecture import messaging
    x, y, z, w = _unit(q_icrf_from_sensor)
    payload = messaging.STSensorMsgPayload()
    payload.timeTag = _time_ns(time_ns)
    payload.qInrtl2Case = [w, x, y, z]
    return payload


def navigation_payload(time_ns: int, q_icrf_from_body: np.ndarray, rate_rad_s: np.ndarray
                       ) -> Any:
    """Return the NavAttMsgPayload: sigma_BN, omega_BN_B (3,) on body axes, timeTag in s."""
    from Basilisk.architecture import messaging
    payload = messaging.NavAttMsgPayload()
    payload.timeTag = _time_ns(time_ns) * 1e-9
    payload.sigma_BN = mrp_from_quaternion(q_icrf_from_body).tolist()
    payload.omega_BN_B = _finite(rate_rad_s, 'rate', 3).tolist()
    return payload


def _time_ns(time_ns: int) -> int:
    if time_ns < 0:
        raise MeasurementError(f'time of {time_ns} ns is before the start of the simulation')
    return int(time_ns)


def _finite(vector: np.ndarray, name: str, length: int) -> np.ndarray:
    vector = np.asarray(vector, float)
    if vector.shape != (length,) or not np.isfinite(vector).all():
        raise MeasurementError(f'{name} {vector.tolist()} is not {length} finite numbers')
    return vector


def _unit(q: np.ndarray) -> np.ndarray:
    q = _finite(q, 'quaternion', 4)
    if not abs(np.linalg.norm(q) - 1) < 1e-6:
        raise MeasurementError(f'quaternion {q.tolist()} is not an attitude: its norm is not 1')
    return q

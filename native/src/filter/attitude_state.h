// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Attitude, body rate and gyro drift with their covariance: the state of the one filter.
//
// The multiplicative extended Kalman filter (MEKF) of Lefferts, Markley and Shuster (J. Guid.
// Control 5, 1982). The attitude is the quaternion; the error state about sensor axes is
// [turn rad, rate rad/s, drift rad/s, constants], with truth = turned(estimate, turn). Constants
// are what the fusion of several heads estimates of their mounts; a single tracker has none.

#pragma once

#include <cstdint>

#include "maths/matrix.h"
#include "maths/rotation.h"

namespace st {

/// Elements of the error state of a state without constants.
constexpr int STATE_SIZE = 9;

/// How many of at most MOST constants are in use.
template <int MOST>
struct Constants {
    int count;
};

template <>
struct Constants<0> {
    static constexpr int count = 0;
};

/// The state at a time. rate and drift are on sensor axes, a gyro measures their sum.
template <int MOST>
struct StateWith {
    int64_t stamp_ns;
    Quaternion quaternion;  // q_icrf_from_sensor
    Vector3 rate_rad_s, drift_rad_s;
    Matrix<STATE_SIZE + MOST, STATE_SIZE + MOST> covariance;  // of the error state
    Constants<MOST> constants;

    int size() const { return STATE_SIZE + constants.count; }
};

/// That of a single tracker.
using AttitudeState = StateWith<0>;

/// What stars measure, in information form: the turn from a quaternion, 3 elements, or the turn
/// and the difference from a rate, 6. information is the inverse covariance, which may be
/// singular, vector is information times what was measured.
struct Information {
    int size;  // 3 or 6
    Matrix<6, 6> information;
    Vector<6> vector;
};

/// Return a state updated by what stars measure about its quaternion and rate.
AttitudeState with_measured(const AttitudeState &state, const Information &measured);

/// Return a state with a drift of zero, of this 1-sigma error and uncorrelated.
AttitudeState with_new_drift(AttitudeState state, double sigma_rad_s);

}  // namespace st

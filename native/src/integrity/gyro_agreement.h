// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Whether a gyro turns the attitude as the stars do.
//
// An attitude that the stars of a frame measured is propagated by the rates alone and compared with
// what the stars measure in the frames after. The longer it runs the finer the comparison: after T
// seconds a rate that is off by e is seen once e T exceeds the noise of both and the drift allowed.

#pragma once

#include "filter/gyro.h"

namespace st {

/// What is known of a gyro by good frames in turn. All zero at the start.
struct GyroAgreement {
    bool has_reference;
    AttitudeState reference;        // what the rates propagate
    int agreed, compared, against;  // frames
    int needed;                     // that must agree
};

/// An attitude that the stars of a frame measure, and what is known of the drift of the gyro.
struct MeasuredAttitude {
    int64_t stamp_ns;
    Quaternion quaternion;  // q_icrf_from_sensor
    Matrix3 covariance;
    Vector3 drift_rad_s;
    Matrix3 drift_covariance;
};

/// Restart with the next frame.
void interrupt_agreement(GyroAgreement &agreement);

/// Restart with a gyro that contradicts the stars.
void contradict_agreement(GyroAgreement &agreement);

/// Whether so many frames agreed, and more after a contradiction.
inline bool is_enough(const GyroAgreement &agreement, int frames) {
    return agreement.agreed >= frames && agreement.agreed >= agreement.needed;
}

/// Add a frame. Return whether the gyro contradicts the stars.
bool add_frame(const Gyro &gyro, const MeasuredAttitude &measured, GyroAgreement &agreement);

}  // namespace st

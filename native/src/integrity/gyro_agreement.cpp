// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/gyro_agreement.h"

#include "integrity/checks.h"
#include "maths/symmetric.h"

namespace st {
namespace {

constexpr int LONGEST = 100;  // frames, after which the comparison restarts
constexpr int AGAIN = 30;     // frames that must agree after a contradiction

/// Return the state that the rates propagate: an attitude with the drift that is known.
AttitudeState reference_of(const MeasuredAttitude &measured) {
    AttitudeState state{};
    state.stamp_ns = measured.stamp_ns;
    state.quaternion = measured.quaternion;
    state.drift_rad_s = measured.drift_rad_s;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            state.covariance[i][j] = measured.covariance[i][j];
            state.covariance[6 + i][6 + j] = measured.drift_covariance[i][j];
        }
    }
    return state;
}

}  // namespace

void interrupt_agreement(GyroAgreement &agreement) {
    agreement.has_reference = false;
    agreement.agreed = agreement.compared = agreement.against = 0;
}

void contradict_agreement(GyroAgreement &agreement) {
    interrupt_agreement(agreement);
    agreement.needed = AGAIN;
}

bool add_frame(const Gyro &gyro, const MeasuredAttitude &measured, GyroAgreement &agreement) {
    if (!agreement.has_reference || agreement.compared == LONGEST) {
        agreement.has_reference = true;
        agreement.reference = reference_of(measured);
        agreement.compared = 0;
        return false;
    }
    ++agreement.compared;
    const AttitudeState predicted = gyro.predicted(agreement.reference, measured.stamp_ns);
    const Vector3 turn = rotation_between(predicted.quaternion, measured.quaternion);
    Matrix3 S = measured.covariance;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            S[i][j] += predicted.covariance[i][j];
        }
    }
    if (dot(turn, inverse(S) * turn) <= checks::GYRO_DIFFERS.threshold) {
        ++agreement.agreed;
        agreement.against = 0;
        return false;
    }
    ++agreement.against;
    if (agreement.against < checks::GYRO_DIFFERS.frames) {
        return false;
    }
    contradict_agreement(agreement);
    return true;
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "filter/attitude_state.h"

namespace st {

namespace {

/// With H = [I 0], Y the information and y the vector:
///
///     P <- P - P H^T (I + Y H P H^T)^-1 Y H P,  x <- x + P H^T y
///
/// (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 7.2:
/// the information filter, without an inverse of Y, which may be singular).
template <int N>
AttitudeState measured_by(const AttitudeState &state, const Matrix<N, N> &Y, const Vector<N> &y) {
    const auto &P = state.covariance;
    const auto columns = block<STATE_SIZE, N>(P, 0, 0);
    const auto rows = block<N, STATE_SIZE>(P, 0, 0);
    double determinant = 0.0;
    const auto gain = solved_by_pivots(identity<N>() + Y * block<N, N>(P, 0, 0), Y, determinant);
    AttitudeState after = state;
    after.covariance = P - columns * gain * rows;
    // Rounding makes it unsymmetric, and what is unsymmetric would grow from frame to frame.
    const auto half = after.covariance + transposed(after.covariance);
    Vector<STATE_SIZE> change{};
    for (int i = 0; i < STATE_SIZE; ++i) {
        for (int j = 0; j < STATE_SIZE; ++j) {
            after.covariance[i][j] = half[i][j] / 2;
        }
        for (int j = 0; j < N; ++j) {
            change[i] += after.covariance[i][j] * y[j];
        }
    }
    after.quaternion = turned(state.quaternion, first<3>(change));
    for (int axis = 0; axis < 3; ++axis) {
        after.rate_rad_s[axis] += change[3 + axis];
        after.drift_rad_s[axis] += change[6 + axis];
    }
    return after;
}

}  // namespace

AttitudeState with_measured(const AttitudeState &state, const Information &measured) {
    if (measured.size == 3) {
        return measured_by(state, block<3, 3>(measured.information, 0, 0),
                           first<3>(measured.vector));
    }
    return measured_by(state, measured.information, measured.vector);
}

AttitudeState with_new_drift(AttitudeState state, double sigma_rad_s) {
    state.drift_rad_s = {};
    for (int i = 0; i < STATE_SIZE; ++i) {
        for (int j = 6; j < STATE_SIZE; ++j) {
            state.covariance[i][j] = state.covariance[j][i] = 0.0;
        }
    }
    for (int j = 6; j < STATE_SIZE; ++j) {
        state.covariance[j][j] = sigma_rad_s * sigma_rad_s;
    }
    return state;
}

}  // namespace st

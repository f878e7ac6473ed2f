// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "fusion/fused_state.h"

#include <cmath>

#include "maths/symmetric.h"

namespace st {

void fuse(const BodyMotionState &motion, const Weights &weight, FusedState &state) {
    state.body = state_of(motion, weight);
    constants_of(motion, weight, state.coefficients);
}

bool has_covariance(const BodyState &state) {
    double sum = 0.0;
    bool positive = true;
    for (int i = 0; i < state.size(); ++i) {
        positive = positive && state.covariance[i][i] >= 0;
        for (int k = 0; k < state.size(); ++k) {
            sum += state.covariance[i][k];
        }
    }
    return std::isfinite(sum) && positive && is_positive_definite(state.covariance);
}

/// S = H P H^T + R with H = [I 0 0 B], B in the columns of the mount.
HeadInnovation innovation_of(const BodyState &state, const HeadMeasurement &measured) {
    const auto &P = state.covariance;
    const auto [first, count] = measured.columns;
    Matrix3 S = block<3, 3>(P, 0, 0) + measured.covariance;
    if (count > 0) {
        const int own = STATE_SIZE + first;
        Matrix3 cross{}, of_mount{};
        for (int k = 0; k < count; ++k) {
            double half[3] = {};  // row k of P_cc B^T
            for (int m = 0; m < count; ++m) {
                for (int j = 0; j < 3; ++j) {
                    half[j] += P[own + k][own + m] * measured.B[j][m];
                }
            }
            for (int i = 0; i < 3; ++i) {
                for (int j = 0; j < 3; ++j) {
                    cross[i][j] += measured.B[i][k] * P[own + k][j];
                    of_mount[i][j] += measured.B[i][k] * half[j];
                }
            }
        }
        S = S + cross + transposed(cross) + of_mount;
    }
    const Vector3 z = rotation_between(state.quaternion, measured.quaternion);
    return {measured, z, dot(z, inverse(S) * z)};
}

/// The noise of a frame is a mean by information: each axis is known from the heads that see it
/// well.
void update_by_head(const HeadMeasurement &measured, int64_t before_ns, const double *assumed,
                    BodyMotionState &motion) {
    MotionMeasurement<MOST_CONSTANTS> stars{};
    stars.quaternion = measured.quaternion;
    stars.stars.size = 3;
    set_block(stars.stars.information, 0, 0, inverse(measured.covariance));
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < measured.columns.count; ++k) {
            stars.beside[i][CONSTANT - ACCELERATION + measured.columns.first + k] =
                measured.B[i][k];
            stars.moved[i] += measured.B[i][k] * assumed[k];
        }
    }
    update_motion(stars, motion);
    for (int axis = 0; axis < 3; ++axis) {
        double &noise = motion.noise_rad2[axis];
        noise = 1 / (NOISE_MEMORY / noise + (1 - NOISE_MEMORY) / measured.covariance[axis][axis]);
    }
    const double dt_s = static_cast<double>(motion.stamp_ns - before_ns) * 1e-9;
    if (dt_s > 0) {
        // Heads have their frames at times of their own, or at one.
        const double most_s = std::fmin(dt_s, 2 * motion.interval_s);
        motion.interval_s += (1 - NOISE_MEMORY) * (most_s - motion.interval_s);
    }
}

}  // namespace st

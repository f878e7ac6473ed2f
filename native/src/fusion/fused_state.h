// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The state of the fusion: the motion of the body, and the misalignments of heads in addition to
// it.
//
// It is that of filter/motion.h, whose constants are the coefficients c of the mounts. Its error
// state about body axes is [turn rad, rate rad/s, drift rad/s, c].

#pragma once

#include "filter/motion.h"
#include "startracker_fusion.h"

namespace st {

static_assert(ST_MOST_COEFFICIENTS == MOST_CONSTANTS);

using BodyMotionState = MotionWith<MOST_CONSTANTS>;
using BodyState = StateWith<MOST_CONSTANTS>;

constexpr int MOST_TERMS = 4, MOST_OWN = 3 * MOST_TERMS;  // of the law of a mount

/// The coefficients of a head among those of all.
struct Columns {
    int first, count;
};

/// d(misalignment) / d(coefficients) of a head, of as many columns as it has.
using Sensitivity = Matrix<3, MOST_OWN>;

/// A measured attitude of the body, by the estimated mount of a head.
struct HeadMeasurement {
    Quaternion quaternion;  // q_icrf_from_body
    Matrix3 covariance;     // about body axes
    Columns columns;
    Sensitivity B;
};

/// The mean of a motion by weights of its modes, with the coefficients.
struct FusedState {
    BodyState body;
    double coefficients[MOST_CONSTANTS];
};

/// Fill the state of a motion by weights.
void fuse(const BodyMotionState &motion, const Weights &weight, FusedState &state);

/// Whether the covariance is one: finite, no variance negative, that of the attitude positive
/// definite.
bool has_covariance(const BodyState &state);

/// What a measurement differs from a state by: z, and z^T S^-1 z.
struct HeadInnovation {
    HeadMeasurement measured;
    Vector3 z;
    double nis;
};

HeadInnovation innovation_of(const BodyState &state, const HeadMeasurement &measured);

/// Update a motion by a measurement for which these coefficients of its mount were assumed;
/// before_ns is the stamp of the frame before.
void update_by_head(const HeadMeasurement &measured, int64_t before_ns, const double *assumed,
                    BodyMotionState &motion);

}  // namespace st

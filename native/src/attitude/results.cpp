// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "attitude/results.h"

#include <cmath>

namespace st {

void set_unknown(st_attitude &attitude) {
    constexpr Vector3 VECTOR{{NAN, NAN, NAN}};
    constexpr Matrix3 MATRIX{{{NAN, NAN, NAN}, {NAN, NAN, NAN}, {NAN, NAN, NAN}}};
    attitude = {};
    set(Quaternion{NAN, NAN, NAN, NAN}, attitude.quaternion);
    set(MATRIX, attitude.covariance_rad2);
    set(VECTOR, attitude.rate_rad_s);
    set(MATRIX, attitude.rate_covariance);
    set(MATRIX, attitude.cross_covariance);
    set(VECTOR, attitude.acceleration_rad_s2);
    set(VECTOR, attitude.jerk_rad_s3);
    set(VECTOR, attitude.acceleration_sigma_rad_s2);
    set(VECTOR, attitude.acceleration_sigma_before_rad_s2);
    set(VECTOR, attitude.protection_rad);
    attitude.chi2 = attitude.residual_px = NAN;
}

}  // namespace st

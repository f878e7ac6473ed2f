// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// An attitude at another time than its own.

#pragma once

#include "startracker.h"

namespace st {

/// Return a valid attitude at a time near its own, before or after it.
///
/// As that of a row of a rolling shutter, by rate, acceleration and jerk. The covariance is
/// P + dt (C + C^T) + dt^2 P_rate, C that of attitude and rate; where C is not known it is the bound
/// (1 + k) P + (1 + 1 / k) dt^2 P_rate, which holds for any, with the k of least trace. An error a of
/// the acceleration adds (a dt^2 / 2)^2. There is no protection level at another time.
st_attitude attitude_at(const st_attitude &attitude, int64_t stamp_ns);

}  // namespace st

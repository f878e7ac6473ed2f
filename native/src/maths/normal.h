// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Quantiles of the normal distribution.

#pragma once

namespace st {

/// Return the z that a normal value exceeds with a probability of 1 - p, for 0 < p < 1; good to
/// 1e-15 of itself (Wichura, Applied Statistics 37, 1988, algorithm AS 241).
double normal_quantile(double p);

/// Return how many sigma a normal value exceeds, up or down, with a probability; 0 from 1 on.
inline double two_sided_sigmas(double probability) {
    return probability < 1 ? -normal_quantile(probability / 2) : 0.0;
}

}  // namespace st

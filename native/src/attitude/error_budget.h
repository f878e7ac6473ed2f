// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What a published covariance consists of: st_budget of startracker.h.

#pragma once

#include "maths/matrix.h"
#include "startracker.h"

namespace st {

/// Return the sum of all terms, rad^2 about sensor axes.
///
/// stars        noise of centroids and catalogue, through the filter
/// motion       motions that may begin in the frame, and their light
/// exposure     shaking within the exposure, alike for all stars: pointing_covariance()
/// stamps       errors of the stamps, times the rate: stamp_jitter.h
/// shutter      errors of line_time_us, times the rate
/// lens         errors of the lens that stay from frame to frame: lens_error.h
/// observer     its unknown velocity, by aberration: systematic_errors.h
/// epoch        unknown date, by proper motion: systematic_errors.h
Matrix3 covariance_of(const st_budget &budget);

}  // namespace st

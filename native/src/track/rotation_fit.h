// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The common rotation of all stars of a frame, and the outliers.

#pragma once

#include "attitude/solution.h"
#include "camera/lens.h"
#include "integrity/checks.h"
#include "maths/arena.h"

namespace st {

/// Residual of a star over its sigma that makes it an outlier.
inline double outlier_sigmas() {
    return sigmas(checks::STAR_OUTLIER);
}

/// sqrt(2 log 2): median distance from the truth in two dimensions, in units of sigma per axis.
constexpr double RAYLEIGH_MEDIAN = 1.1774100225154747;

/// An attitude and the residuals of the stars (count).
///
/// normalised is the residual of each star over its own sigma times scale, which is above 1 where a
/// lens that is not calibrated moves all stars; inlier masks the stars of the fit, of which attitude
/// is the solution; residual_px is their rms residual.
struct RotationFit {
    Solution attitude;
    double scale, residual_px;
    int count;
    double *normalised;
    bool *inlier;
};

/// Whether min_stars, and a third of stars, fit within max_residual_px rms.
bool is_good(int inliers, int stars, double residual_px, int min_stars, double max_residual_px);

/// Return the bytes that rotation_fit_for() takes, and of work memory of fit_rotation().
size_t rotation_fit_bytes(int count);
size_t rotation_fit_work_bytes(int count);

/// Return a fit without numbers, of count stars.
RotationFit rotation_fit_for(int count, Arena &arena);

/// Fit the attitude of candidates without outliers, and the residuals of all stars; false where too
/// few are left.
///
/// icrf, uv, sigma_px per axis and candidate have fit.count elements. One outlier is removed at a
/// time, the worst: it biases the fit. Outliers and residuals are those of the best fit of all stars,
/// the attitude is that of the solver.
bool fit_rotation(const Lens &lens, const Vector3 *icrf, const Point *uv, const double *sigma_px,
                  const bool *candidate, st_solver solver, RotationFit &fit, Arena &work);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The attitude of one frame of known stars, reported only when it can be trusted.

#pragma once

#include "attitude/solution.h"
#include "camera/lens.h"
#include "maths/covariance2.h"
#include "startracker.h"

namespace st {

/// A star that the catalogue has: its pixel, the error of its centroid, its apparent direction, and
/// its proper motion, rad a year on ICRS axes.
struct KnownStar {
    Point uv;
    Covariance2 error;
    Vector3 icrf, motion_rad_year;
};

/// A track of a star: its pixel, the apparent direction, and the error and residual of its centroid,
/// NaN where it was missed.
struct TrackedStar {
    Point uv;
    Vector3 icrf;
    double sigma_px, residual_px;
};

/// What is not known of the observer: its velocity, and the epoch of the star places.
struct ObserverError {
    double velocity_sigma_m_s, epoch_sigma_years;
};

/// An attitude that can be trusted, or the reason why there is none. stars are those it is of;
/// residual_px is their rms distance from the catalogue.
struct TrustedAttitude {
    st_reason reason;  // ST_REASON_TRUSTED
    int stars;
    Quaternion quaternion;
    Matrix3 covariance;
    double chi2, residual_px;
    Vector3 protection_rad;
};

/// Accepts or rejects attitudes, solved here or by a star tracker. The sign of the quaternion is
/// continuous from one accepted attitude to the next.
class AttitudeValidator {
public:
    AttitudeValidator() = default;
    AttitudeValidator(const Lens &lens, const st_trust_options &options);

    /// Use other options from the next frame on.
    void set_limits(const st_trust_options &options) { options_ = options; }

    /// Forget the sign of the last quaternion.
    void reset() { has_previous_ = false; }

    /// Return the attitude of stars (count) by the solver of the options. Where errors are not round,
    /// the best fit to them starts at that of the solver, unless this takes two stars only. The
    /// covariance is inflated when chi2 rejects the residuals at such errors, and contains what is not
    /// known of the observer. residual_rad (count) is filled where there is an attitude: the angles
    /// between the stars and the catalogue.
    TrustedAttitude solve(const KnownStar *stars, int count, const ObserverError &observer,
                          double *residual_rad, Arena &arena);

    /// Return the attitude of a star tracker, quaternion and covariance, if the rms distance of its
    /// tracks (count) from it is small.
    TrustedAttitude check(const Quaternion &quaternion, const Matrix3 &covariance, double chi2,
                          const TrackedStar *stars, int count, double *residual_rad, Arena &arena);

private:
    TrustedAttitude trusted(const TrustedAttitude &attitude);

    Lens lens_{};
    st_trust_options options_{};
    Quaternion previous_{};
    bool has_previous_ = false;
};

/// Bytes of work memory of so many stars.
size_t validation_bytes(int count);

}  // namespace st

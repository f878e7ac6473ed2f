// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/validation.h"

#include <cmath>

#include "attitude/error_ellipses.h"
#include "attitude/pointing.h"
#include "integrity/checks.h"
#include "integrity/protection.h"
#include "integrity/systematic_errors.h"
#include "maths/gates.h"

namespace st {
namespace {

using namespace checks;

TrustedAttitude rejected(const st_reason &reason) {
    TrustedAttitude none{};
    none.reason = reason;
    return none;
}

TrustedAttitude too_few(int count, int min_stars, bool tracked) {
    return rejected(reason_of(FEW_STARS, {static_cast<double>(count),
                                          static_cast<double>(min_stars), tracked ? 1.0 : 0.0}));
}

FalseStars false_stars(const st_trust_options &options) {
    return {options.misleading_probability, options.false_star_probability};
}

/// Lists of stars, and those of a solution.
struct Lists {
    Point *uv;
    Covariance2 *error;
    Vector3 *sensor, *icrf, *motion;
    double *sigma_rad;
    StarError *star;

    Lists(int count, Arena &arena) {
        const auto n = static_cast<size_t>(count);
        uv = arena.take<Point>(n);
        error = arena.take<Covariance2>(n);
        sensor = arena.take<Vector3>(n);
        icrf = arena.take<Vector3>(n);
        motion = arena.take<Vector3>(n);
        sigma_rad = arena.take<double>(n);
        star = arena.take<StarError>(n);
    }
};

/// Return a covariance scaled where chi2 is larger than chance makes it, of such a mean.
Matrix3 inflated(const Solution &solution, double mean) {
    const bool is_large = solution.chi2 > gate(LARGE_CHI2.probability, mean);
    const double excess = is_large ? solution.chi2 / mean : 1.0;
    Matrix3 P = solution.covariance;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            P[i][j] *= excess;
        }
    }
    return P;
}

}  // namespace

AttitudeValidator::AttitudeValidator(const Lens &lens, const st_trust_options &options)
    : lens_(lens), options_(options) {}

TrustedAttitude AttitudeValidator::trusted(const TrustedAttitude &attitude) {
    const Matrix3 &P = attitude.covariance;
    if (!is_covariance(P)) {
        return rejected(reason_of(COVARIANCE, {P[0][0], P[1][1], P[2][2]}));
    }
    previous_ =
        sign_continuous(attitude.quaternion, has_previous_ ? previous_ : Quaternion{0, 0, 0, 1});
    has_previous_ = true;
    TrustedAttitude result = attitude;
    result.quaternion = previous_;
    result.reason = reason_of(ST_REASON_TRUSTED, {});
    return result;
}

TrustedAttitude AttitudeValidator::solve(const KnownStar *stars, int count,
                                         const ObserverError &observer, double *residual_rad,
                                         Arena &arena) {
    if (count < options_.min_stars) {
        return too_few(count, options_.min_stars, false);
    }
    const Arena::Scope scope(arena);
    const Lists list(count, arena);
    const double pixel_rad = pixel_angle(lens_);
    for (int i = 0; i < count; ++i) {
        const KnownStar &star = stars[i];
        list.uv[i] = star.uv;
        list.error[i] = star.error;
        list.icrf[i] = star.icrf;
        list.motion[i] = star.motion_rad_year;
        list.sensor[i] = unproject(lens_, star.uv);
        list.sigma_rad[i] = pixel_rad * std::sqrt((star.error.uu + star.error.vv) / 2);
    }
    const auto solver = static_cast<st_solver>(options_.solver);
    Solution solution = st::solve(solver, list.sensor, list.icrf, list.sigma_rad, count, arena);
    if (solution.reason.code != ST_NO_REASON) {
        return rejected(solution.reason);
    }
    const double mean = mean_chi2(solution, list.icrf, list.sigma_rad);
    if (solver != ST_TRIAD) {
        fit_error_ellipses(lens_, list.uv, list.error, list.icrf, solution, arena);
    }
    double square = 0.0;
    for (int i = 0; i < count; ++i) {
        residual_rad[i] = solution.residual_rad[i];
        square += solution.residual_rad[i] * solution.residual_rad[i];
        list.star[i] = {list.sensor[i], list.sigma_rad[i], solution.residual_rad[i]};
    }
    const double residual_px = std::sqrt(square / count) / pixel_rad;
    if (!(residual_px <= options_.max_residual_px)) {
        return rejected(reason_of(STAR_RESIDUALS, {residual_px, options_.max_residual_px}));
    }
    const FittedStars fitted{count, list.sensor, list.sigma_rad, list.motion};
    Matrix3 P = inflated(solution, mean);
    if (observer.velocity_sigma_m_s != 0) {
        P = P + velocity_covariance(observer.velocity_sigma_m_s, fitted);
    }
    P = P + epoch_covariance(solution.quaternion, observer.epoch_sigma_years, fitted);
    return trusted({{},
                    count,
                    solution.quaternion,
                    P,
                    solution.chi2,
                    residual_px,
                    protection_level(P, list.star, count, false_stars(options_), 0)});
}

TrustedAttitude AttitudeValidator::check(const Quaternion &quaternion, const Matrix3 &covariance,
                                         double chi2, const TrackedStar *stars, int count,
                                         double *residual_rad, Arena &arena) {
    if (count < options_.min_stars) {
        return too_few(count, options_.min_stars, true);
    }
    const Arena::Scope scope(arena);
    StarError *star = arena.take<StarError>(static_cast<size_t>(count));
    const double pixel_rad = pixel_angle(lens_), outlier = sigmas(STAR_OUTLIER);
    const Matrix3 R = matrix_from_quaternion(quaternion);
    double square = 0.0;
    for (int i = 0; i < count; ++i) {
        const TrackedStar &track = stars[i];
        const Point expected = project(lens_, sensor_direction(R, track.icrf));
        const double away = std::hypot(track.uv.x - expected.x, track.uv.y - expected.y);
        residual_rad[i] = away * pixel_rad;
        square += away * away;
        // A centroid further away is not that of the star, and was not used.
        const double farthest_px = outlier * track.sigma_px;
        const double residual_px =
            track.residual_px > farthest_px ? farthest_px : track.residual_px;
        star[i] = {unproject(lens_, track.uv), track.sigma_px * pixel_rad,
                   std::isnan(track.residual_px) ? 0.0 : residual_px * pixel_rad};
    }
    const double rms_px = std::sqrt(square / count);
    if (!(rms_px <= options_.max_residual_px)) {
        return rejected(reason_of(TRACK_RESIDUALS, {rms_px, options_.max_residual_px}));
    }
    return trusted({{},
                    count,
                    quaternion,
                    covariance,
                    chi2,
                    rms_px,
                    protection_level(covariance, star, count, false_stars(options_), 0)});
}

size_t validation_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return Arena::padded<Point>(n) + Arena::padded<Covariance2>(n) +
           3 * Arena::padded<Vector3>(n) + Arena::padded<double>(n) + Arena::padded<StarError>(n) +
           solve_bytes(count) + error_ellipses_bytes(count);
}

}  // namespace st

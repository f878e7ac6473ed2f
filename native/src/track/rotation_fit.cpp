// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/rotation_fit.h"

#include <algorithm>
#include <cmath>

#include "attitude/pointing.h"
#include "maths/sorting.h"

namespace st {

bool is_good(int inliers, int stars, double residual_px, int min_stars, double max_residual_px) {
    const double third = std::ceil(stars / limit(checks::FEW_AGREE, "stars_for_one"));
    return inliers >= std::fmax(min_stars, third) && residual_px <= max_residual_px;
}

size_t rotation_fit_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return 2 * Arena::padded<double>(n) + Arena::padded<bool>(n);
}

size_t rotation_fit_work_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return solve_bytes(count) + 3 * Arena::padded<Vector3>(n) + 4 * Arena::padded<double>(n);
}

RotationFit rotation_fit_for(int count, Arena &arena) {
    const auto n = static_cast<size_t>(count);
    RotationFit fit{};
    fit.count = count;
    fit.attitude.residual_rad = arena.take<double>(n);
    fit.normalised = arena.take<double>(n);
    fit.inlier = arena.take<bool>(n);
    return fit;
}

namespace {

/// The stars of a frame, and those of a fit one behind the other.
struct Stars {
    const Lens &lens;
    const Vector3 *icrf;
    const Point *uv;
    const double *sigma_px;
    Vector3 *sensor;  // (count)
    Vector3 *fit_sensor, *fit_icrf;
    double *fit_sigma_rad;

    /// Solve the attitude of the inliers, without the memory of its residuals.
    bool solved(st_solver solver, RotationFit &fit, Arena &work) const {
        const Arena::Scope scope(work);
        int count = 0;
        for (int n = 0; n < fit.count; ++n) {
            if (fit.inlier[n]) {
                fit_sensor[count] = sensor[n];
                fit_icrf[count] = icrf[n];
                fit_sigma_rad[count++] = sigma_px[n] * pixel_angle(lens);
            }
        }
        if (count < 2) {
            return false;
        }
        const Solution solution = solve(solver, fit_sensor, fit_icrf, fit_sigma_rad, count, work);
        if (solution.reason.code != ST_NO_REASON) {
            return false;
        }
        double *residual_rad = fit.attitude.residual_rad;
        std::copy_n(solution.residual_rad, count, residual_rad);
        fit.attitude = solution;
        fit.attitude.residual_rad = residual_rad;
        return true;
    }
};

}  // namespace

bool fit_rotation(const Lens &lens, const Vector3 *icrf, const Point *uv, const double *sigma_px,
                  const bool *candidate, st_solver solver, RotationFit &fit, Arena &work) {
    const Arena::Scope scope(work);
    const auto n = static_cast<size_t>(fit.count);
    const Stars stars{lens,
                      icrf,
                      uv,
                      sigma_px,
                      work.take<Vector3>(n),
                      work.take<Vector3>(n),
                      work.take<Vector3>(n),
                      work.take<double>(n)};
    auto *distance = work.take<double>(n), *ordered = work.take<double>(n);
    for (int i = 0; i < fit.count; ++i) {
        stars.sensor[i] = unproject(lens, uv[i]);
        fit.inlier[i] = candidate[i];
    }
    while (true) {
        if (!stars.solved(ST_QUEST, fit, work)) {
            return false;
        }
        const Matrix3 R = matrix_from_quaternion(fit.attitude.quaternion);
        int inliers = 0;
        double square = 0.0;
        bool is_known = true;
        for (int i = 0; i < fit.count; ++i) {
            const Point predicted = project(lens, sensor_direction(R, icrf[i]));
            distance[i] = std::hypot(uv[i].x - predicted.x, uv[i].y - predicted.y);
            fit.normalised[i] = distance[i] / sigma_px[i];
            if (fit.inlier[i]) {
                ordered[inliers++] = fit.normalised[i];
                square += distance[i] * distance[i];
                is_known = is_known && !std::isnan(distance[i]);
            }
        }
        const double typical = is_known ? median(ordered, inliers) / RAYLEIGH_MEDIAN : 1.0;
        fit.scale = typical > 1 ? typical : 1.0;
        int worst = 0;
        double most = -1.0;
        for (int i = 0; i < fit.count; ++i) {
            const double normalised = fit.normalised[i] / fit.scale;
            fit.normalised[i] = std::isfinite(normalised) ? normalised : INFINITY;
            if (fit.inlier[i] && fit.normalised[i] > most) {
                most = fit.normalised[i];
                worst = i;
            }
        }
        if (most <= outlier_sigmas()) {
            fit.residual_px = std::sqrt(square / inliers);
            return solver == ST_QUEST || stars.solved(solver, fit, work);
        }
        fit.inlier[worst] = false;
    }
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Attitudes by themselves, for tools on the ground.

#include <algorithm>

#include "attitude/results.h"
#include "attitude/solution.h"
#include "ground.h"
#include "identify/identification_stage.h"
#include "integrity/protection.h"
#include "startracker_ground.h"

using namespace st;

namespace {

constexpr size_t MOST_STARS = 10000000;
static_assert(sizeof(StarError) == 5 * sizeof(double), "rows of a caller are used in place");

}  // namespace

extern "C" {

st_status st_fit_attitude(int32_t solver, const double *sensor, const double *icrf,
                          const double *sigma_rad, size_t count, st_attitude *attitude,
                          double *residual_rad, st_reason *reason, void *work, size_t bytes) {
    if (sensor == nullptr || icrf == nullptr || sigma_rad == nullptr || attitude == nullptr ||
        residual_rad == nullptr || reason == nullptr || work == nullptr) {
        return ST_NULL_POINTER;
    }
    if (solver < 0 || solver > ST_TRIAD || count > MOST_STARS) {
        return ST_BAD_INPUT;
    }
    const auto stars = static_cast<int>(count);
    if (bytes < solve_bytes(stars) + ALIGNMENT) {
        return ST_TOO_LITTLE_MEMORY;
    }
    Arena arena(work, bytes);
    const Solution found = solve(static_cast<st_solver>(solver), vectors(sensor), vectors(icrf),
                                 sigma_rad, stars, arena);
    set_unknown(*attitude);
    *reason = found.reason;
    if (found.reason.code == ST_NO_REASON) {
        set_fit({found.quaternion, found.covariance, found.chi2}, found.residual_rad, stars, 1.0,
                *attitude);
        std::copy_n(found.residual_rad, count, residual_rad);
    }
    return ST_OK;
}

st_status st_protection_level(const double covariance_rad2[9], const double *stars, size_t count,
                              double misleading_probability, double false_star_probability,
                              int32_t rejected, double level_rad[3]) {
    if (covariance_rad2 == nullptr || level_rad == nullptr || (count > 0 && stars == nullptr)) {
        return ST_NULL_POINTER;
    }
    if (count > MOST_STARS || rejected < 0) {
        return ST_BAD_INPUT;
    }
    Matrix3 P;
    std::copy_n(covariance_rad2, 9, &P.row[0][0]);
    const Vector3 level =
        protection_level(P, reinterpret_cast<const StarError *>(stars), static_cast<int>(count),
                         {misleading_probability, false_star_probability}, rejected);
    std::copy_n(level.element, 3, level_rad);
    return ST_OK;
}

}  // extern "C"

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/protection.h"

#include <cmath>

#include "attitude/refinement.h"
#include "integrity/checks.h"
#include "maths/normal.h"
#include "maths/symmetric.h"

namespace st {
namespace {

/// Least share of the determinant of F that is left without a star that can be done without.
constexpr double LEAST_LEFT = 1e-9;

constexpr Vector3 NO_BOUND{{INFINITY, INFINITY, INFINITY}};

/// The larger two of some values.
struct LargestTwo {
    double first = 0.0, second = 0.0;

    void add(double value) {
        if (value > first) {
            second = first;
            first = value;
        } else if (value > second) {
            second = value;
        }
    }
    double sum() const { return first + second; }
};

}  // namespace

Multipliers multipliers(int count, int rejected, const FalseStars &probabilities) {
    const double n = count;
    const double p = probabilities.false_star_probability +
                     checks::PROTECTION.probability * rejected / (count > 1 ? n : 1.0);
    const double one = n * p, two = n * (n - 1) / 2 * (p * p);
    const double three = n * (n - 1) * (n - 2) / 6 * (p * p * p);
    // Each axis has its own probability.
    const double left = (probabilities.misleading_probability - three) / 3;
    if (!(left > 0) || count < 3) {
        return {};
    }
    return {true, two_sided_sigmas(left), two_sided_sigmas(left / one),
            two > left ? two_sided_sigmas(left / two) : NAN};
}

Vector3 protection_level(const Matrix3 &covariance, const StarError *stars, int count,
                         const FalseStars &probabilities, int rejected) {
    const Multipliers k = multipliers(count, rejected, probabilities);
    if (!k.valid) {
        return NO_BOUND;
    }
    Matrix3 F{};
    for (int i = 0; i < count; ++i) {
        add_information(stars[i].sensor, 1 / (stars[i].sigma_rad * stars[i].sigma_rad), F);
    }
    F = symmetric(F);
    const double smallest = LEAST_LEFT * determinant(F);
    const Matrix3 all_stars = inverse(F);
    Vector3 level;
    LargestTwo pair[3], pair_more[3];
    for (int axis = 0; axis < 3; ++axis) {
        level[axis] = k.none * std::sqrt(covariance[axis][axis]);
    }
    for (int i = 0; i < count; ++i) {
        const Vector3 &p = stars[i].sensor;
        const double weight = 1 / (stars[i].sigma_rad * stars[i].sigma_rad);
        Matrix3 F_i{};
        add_information(p, weight, F_i);
        const Matrix3 without = F - symmetric(F_i);
        // Not known is not bounded.
        if (!(determinant(without) > smallest && std::isfinite(stars[i].residual_rad))) {
            return NO_BOUND;
        }
        const Matrix3 A = inverse(without);
        for (int axis = 0; axis < 3; ++axis) {
            const Vector3 a{{A[axis][0], A[axis][1], A[axis][2]}};
            // |a x p|^2 = a^2 - (a p)^2.
            const double along = dot(a, p), across = dot(a, a) - along * along;
            const double separation =
                stars[i].residual_rad * weight * std::sqrt(across > 0 ? across : 0.0);
            const double gained = a[axis] - all_stars[axis][axis];
            const double more = gained > 0 ? gained : 0.0;
            const double bound = separation + k.one * std::sqrt(covariance[axis][axis] + more);
            level[axis] = bound > level[axis] ? bound : level[axis];
            pair[axis].add(separation);
            pair_more[axis].add(more);
        }
    }
    for (int axis = 0; axis < 3; ++axis) {
        // NaN is never the larger one.
        const double both =
            pair[axis].sum() + k.two * std::sqrt(covariance[axis][axis] + pair_more[axis].sum());
        level[axis] = both > level[axis] ? both : level[axis];
    }
    return level;
}

bool is_covariance(const Matrix3 &P) {
    constexpr double UNEQUAL = 1e-6, TINY = 1e-300;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            if (!(std::isfinite(P[i][j]) &&
                  std::fabs(P[i][j] - P[j][i]) <= UNEQUAL * std::fabs(P[i][j]) + TINY)) {
                return false;
            }
        }
    }
    return is_positive_definite(P);
}

}  // namespace st

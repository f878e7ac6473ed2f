// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "attitude/triad.h"

#include <cmath>

namespace st {
namespace {

/// Return axes by rows: a vector, the normal of the plane of two, and across.
Matrix3 frame(const Vector3 &first, const Vector3 &second) {
    Vector3 normal = cross(first, second);
    normal = scaled(normal, 1 / norm(normal));
    Vector3 across = cross(first, normal);
    across = scaled(across, 1 / norm(across));
    Matrix3 axes;
    for (int k = 0; k < 3; ++k) {
        axes[0][k] = first[k];
        axes[1][k] = normal[k];
        axes[2][k] = across[k];
    }
    return axes;
}

/// Return the square of the sine of the angle between two unit vectors.
double sine2_between(const Vector3 &a, const Vector3 &b) {
    const Vector3 c = cross(a, b);
    return dot(c, c);
}

constexpr StarPair NO_PAIR{-1, -1, INFINITY, 0.0};

}  // namespace

Matrix3 triad(const Directions &stars, int first, int second) {
    return transposed(frame(stars.icrf[first], stars.icrf[second])) *
           frame(stars.sensor[first], stars.sensor[second]);
}

StarPair best_partner(const Directions &stars, const double *sigma_rad, int first) {
    StarPair best = NO_PAIR;
    const double one = sigma_rad[first] * sigma_rad[first];
    for (int second = 0; second < stars.count; ++second) {
        const double sine2 = std::sqrt(sine2_between(stars.sensor[first], stars.sensor[second]) *
                                       sine2_between(stars.icrf[first], stars.icrf[second]));
        if (sine2 > 0) {
            const double variance = one + (one + sigma_rad[second] * sigma_rad[second]) / sine2;
            if (variance < best.variance) {
                best = {first, second, variance, sine2};
            }
        }
    }
    return best;
}

StarPair best_pair(const Directions &stars, const double *sigma_rad) {
    StarPair best = NO_PAIR;
    for (int first = 0; first < stars.count; ++first) {
        const StarPair pair = best_partner(stars, sigma_rad, first);
        if (pair.variance < best.variance) {
            best = pair;
        }
    }
    return best;
}

Matrix3 triad_covariance(const Vector3 &first, const Vector3 &second, double first_sigma_rad,
                         double second_sigma_rad) {
    const Vector3 &a = first, &b = second;
    const double cosine = dot(a, b), sine2 = sine2_between(a, b);
    const double square = first_sigma_rad * first_sigma_rad;
    const double other = second_sigma_rad * second_sigma_rad;
    Matrix3 P;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            P[i][j] =
                (square * cosine * (a[i] * b[j] + b[i] * a[j]) + (other - square) * a[i] * a[j]) /
                sine2;
        }
        P[i][i] += square;
    }
    return P;
}

}  // namespace st

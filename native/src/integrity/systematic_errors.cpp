// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/systematic_errors.h"

#include "attitude/solution.h"
#include "maths/symmetric.h"

namespace st {
namespace {

constexpr double SPEED_OF_LIGHT_M_S = 299792458.0;

double weight_of(const FittedStars &stars, int i) {
    return 1 / (stars.sigma_rad[i] * stars.sigma_rad[i]);
}

/// Return F^-1.
Matrix3 inverse_information_of(const FittedStars &stars) {
    Matrix3 F{};
    for (int i = 0; i < stars.count; ++i) {
        add_information(stars.sensor[i], weight_of(stars, i), F);
    }
    return inverse(symmetric(F));
}

Matrix3 times(double factor, const Matrix3 &A) {
    Matrix3 product;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            product[i][j] = factor * A[i][j];
        }
    }
    return product;
}

/// Return factor v v^T.
Matrix3 outer(double factor, const Vector3 &v) {
    Matrix3 product;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            product[i][j] = factor * (v[i] * v[j]);
        }
    }
    return product;
}

}  // namespace

Matrix3 velocity_covariance(double velocity_sigma_m_s, const FittedStars &stars) {
    Vector3 s{};
    for (int i = 0; i < stars.count; ++i) {
        const double w = weight_of(stars, i);
        for (int k = 0; k < 3; ++k) {
            s[k] += w * stars.sensor[i][k];
        }
    }
    Matrix3 across = outer(-1.0, s);
    for (int k = 0; k < 3; ++k) {
        across[k][k] += dot(s, s);
    }
    const Matrix3 F_inverse = inverse_information_of(stars);
    const double beta = velocity_sigma_m_s / SPEED_OF_LIGHT_M_S;
    return times(beta * beta, F_inverse * across * F_inverse);
}

Matrix3 lens_covariance(double lens_sigma_rad, double scale, const FittedStars &stars) {
    Matrix3 G{};
    Vector3 moved{};
    for (int i = 0; i < stars.count; ++i) {
        const Vector3 &p = stars.sensor[i];
        const double w = weight_of(stars, i);
        add_information(p, w * w, G);
        moved[0] -= w * p[2] * p[1];
        moved[1] += w * p[2] * p[0];
    }
    const Matrix3 F_inverse = inverse_information_of(stars);
    return times(lens_sigma_rad * lens_sigma_rad, F_inverse * symmetric(G) * F_inverse) +
           outer(1.0, scaled(F_inverse * moved, scale));
}

Matrix3 epoch_covariance(const Quaternion &attitude, double sigma_years,
                         const FittedStars &stars) {
    if (stars.motion_rad_year == nullptr || sigma_years == 0 || stars.count < 2) {
        return {};
    }
    const Matrix3 R = matrix_from_quaternion(attitude);
    Vector3 torque{};
    for (int i = 0; i < stars.count; ++i) {
        const Vector3 c = cross(stars.sensor[i], sensor_direction(R, stars.motion_rad_year[i]));
        for (int k = 0; k < 3; ++k) {
            torque[k] += weight_of(stars, i) * c[k];
        }
    }
    const Covariance bound = cramer_rao(stars.sensor, stars.sigma_rad, stars.count);
    return outer(sigma_years * sigma_years, bound.P * torque);
}

}  // namespace st

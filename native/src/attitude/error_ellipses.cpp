// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "attitude/error_ellipses.h"

#include <cmath>

#include "maths/symmetric.h"

namespace st {
namespace {

constexpr int ITERATIONS = 2;         // of Gauss and Newton from the best fit of round errors
constexpr double HALF_STEP_PX = 0.5;  // of the derivatives
constexpr double ROUND = 1e-6;        // relative difference between the axes

/// What is measured of a star: its direction s, D+ and R^-1.
struct Measured {
    Vector3 direction;
    Matrix<2, 3> into_px;
    Covariance2 weight;
};

bool is_round(const Covariance2 &error) {
    return !(std::hypot(error.uu - error.vv, 2 * error.uv) > ROUND * (error.uu + error.vv));
}

Covariance2 inverse(const Covariance2 &R) {
    const double scale = 1 / determinant(R);
    return {scale * R.vv, -scale * R.uv, scale * R.uu};
}

Measured measured(const Lens &lens, const Point &uv, const Covariance2 &error) {
    const Vector3 right = unproject(lens, {uv.x + HALF_STEP_PX, uv.y});
    const Vector3 left = unproject(lens, {uv.x - HALF_STEP_PX, uv.y});
    const Vector3 below = unproject(lens, {uv.x, uv.y + HALF_STEP_PX});
    const Vector3 above = unproject(lens, {uv.x, uv.y - HALF_STEP_PX});
    const Vector3 du{{right[0] - left[0], right[1] - left[1], right[2] - left[2]}};
    const Vector3 dv{{below[0] - above[0], below[1] - above[1], below[2] - above[2]}};
    // D+ = (D^T D)^-1 D^T.
    const Covariance2 inner = inverse({dot(du, du), dot(du, dv), dot(dv, dv)});
    Measured star{unproject(lens, uv), {}, inverse(error)};
    for (int k = 0; k < 3; ++k) {
        star.into_px[0][k] = inner.uu * du[k] + inner.uv * dv[k];
        star.into_px[1][k] = inner.uv * du[k] + inner.vv * dv[k];
    }
    return star;
}

/// Return r = D+ (s - p).
Vector<2> residual(const Measured &star, const Vector3 &p) {
    const Vector3 &s = star.direction;
    return star.into_px * Vector3{{s[0] - p[0], s[1] - p[1], s[2] - p[2]}};
}

/// Return R^-1 x.
Vector<2> weighted(const Covariance2 &weight, const Vector<2> &x) {
    return {{weight.uu * x[0] + weight.uv * x[1], weight.uv * x[0] + weight.vv * x[1]}};
}

}  // namespace

void fit_error_ellipses(const Lens &lens, const Point *uv, const Covariance2 *error,
                        const Vector3 *icrf, Solution &solution, Arena &work) {
    const int count = solution.stars;
    bool all_round = true;
    for (int i = 0; i < count; ++i) {
        all_round = all_round && is_round(error[i]);
    }
    if (all_round) {
        return;
    }
    const Arena::Scope scope(work);
    Measured *star = work.take<Measured>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        star[i] = measured(lens, uv[i], error[i]);
    }
    for (int step = 0; step < ITERATIONS; ++step) {
        const Matrix3 R = matrix_from_quaternion(solution.quaternion);
        Matrix3 F{};
        Vector3 g{};
        for (int i = 0; i < count; ++i) {
            const Vector3 p = sensor_direction(R, icrf[i]);
            const Vector<2> r = weighted(star[i].weight, residual(star[i], p));
            // A row d of D+ times [p]x is d x p.
            const Matrix<2, 3> &D = star[i].into_px;
            const Vector3 A[2] = {cross({{D[0][0], D[0][1], D[0][2]}}, p),
                                  cross({{D[1][0], D[1][1], D[1][2]}}, p)};
            for (int k = 0; k < 3; ++k) {
                const Vector<2> w = weighted(star[i].weight, {{A[0][k], A[1][k]}});
                for (int m = 0; m < 3; ++m) {
                    F[k][m] += w[0] * A[0][m] + w[1] * A[1][m];
                }
                g[k] += A[0][k] * r[0] + A[1][k] * r[1];
            }
        }
        solution.covariance = inverse(F);
        solution.quaternion = multiply(solution.quaternion,
                                       quaternion_from_rotation_vector(solution.covariance * g));
    }
    const Matrix3 R = matrix_from_quaternion(solution.quaternion);
    solution.quaternion = sign_continuous(solution.quaternion, {0, 0, 0, 1});
    solution.chi2 = 0.0;
    for (int i = 0; i < count; ++i) {
        const Vector3 p = sensor_direction(R, icrf[i]);
        const Vector<2> r = residual(star[i], p);
        solution.residual_rad[i] = angle_between(star[i].direction, p);
        solution.chi2 += dot(r, weighted(star[i].weight, r));
    }
}

size_t error_ellipses_bytes(int count) {
    return Arena::padded<Measured>(static_cast<size_t>(count));
}

}  // namespace st

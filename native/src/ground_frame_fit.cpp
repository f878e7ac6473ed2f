// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The stars of one frame fitted by themselves, of startracker_ground.h.
//
// In tangent coordinates (x, y) = (X, Y) / Z a turn (a, b, c) about sensor axes, a change f of the focal
// ratio and k of k1 move a star by
//
//     dx = xy a - (1 + x^2) b + y c + x f + x r^2 k,  dy = (1 + y^2) a - xy b - x c + y f + y r^2 k

#include <algorithm>
#include <cmath>

#include "camera/lens.h"
#include "maths/symmetric.h"
#include "startracker_ground.h"

using namespace st;

namespace {

constexpr double MATCH_SIGMAS = 5.0;
constexpr int LEAST_STARS = 4;
constexpr double MOST_LEVERAGE = 0.9;

/// The design matrix of a star and how far its centroid is from where it is expected, in tangent
/// coordinates.
struct TangentRow {
    Matrix<2, 5> J;
    double z[2];
};

TangentRow tangent_row(const Vector3 &sensor, const Vector3 &measured) {
    const double x = sensor[0] / sensor[2], y = sensor[1] / sensor[2], r2 = x * x + y * y;
    return {{{{x * y, -1 - x * x, y, x, x * r2}, {1 + y * y, -x * y, -x, y, y * r2}}},
            {measured[0] / measured[2] - x, measured[1] / measured[2] - y}};
}

/// Return the nearest of places (count), -1 for none.
int nearest_of(const Point *places, size_t count, const Point &to, double &square) {
    int nearest = -1;
    square = INFINITY;
    for (size_t j = 0; j < count; ++j) {
        const double du = to.x - places[j].x, dv = to.y - places[j].y;
        if (du * du + dv * dv < square) {
            nearest = static_cast<int>(j);
            square = du * du + dv * dv;
        }
    }
    return nearest;
}

/// Fill the residual to the east and north of a star: (z - J turn) / (1 - h), with the leverage
/// h = tr(J P J^T) / (2 sigma^2): the part of its own noise that the fit follows, without which the
/// others would hide it.
void set_residual(const TangentRow &row, double sigma, const Vector3 &turn, const Matrix3 &P,
                  const Matrix3 &R, const Vector3 &d, double residual[2]) {
    const auto J = block<2, 3>(row.J, 0, 0);
    const auto predicted = J * turn;
    const auto S = J * P * transposed(J);
    const double leverage = (S[0][0] + S[1][1]) / (2 * sigma * sigma);
    const double own = 1 - std::min(leverage, MOST_LEVERAGE);
    const Vector3 e =
        R * Vector3{{(row.z[0] - predicted[0]) / own, (row.z[1] - predicted[1]) / own, 0.0}};
    const double across = std::hypot(d[0], d[1]);
    residual[0] = (d[0] * e[1] - d[1] * e[0]) / across;
    residual[1] = (across * across * e[2] - d[2] * (d[0] * e[0] + d[1] * e[1])) / across;
}

}  // namespace

extern "C" {

st_status st_fit_frame(const st_camera *camera, const double quaternion[4],
                       const st_tracked_stars *stars, const double *uv, const double *sigma_px,
                       size_t centroids, st_frame_fit *fit, int32_t *star, int32_t *centroid,
                       double *residual, double *sigma_rad) {
    if (camera == nullptr || quaternion == nullptr || stars == nullptr || fit == nullptr ||
        star == nullptr || centroid == nullptr || residual == nullptr || sigma_rad == nullptr) {
        return ST_NULL_POINTER;
    }
    const Lens lens = lens_of(*camera);
    const double pixel_rad = 1 / std::sqrt(lens.fx * lens.fy);
    const Matrix3 R =
        matrix_from_quaternion({quaternion[0], quaternion[1], quaternion[2], quaternion[3]});
    const auto *direction = reinterpret_cast<const Vector3 *>(stars->direction);
    const auto *tracked = reinterpret_cast<const Point *>(stars->uv);
    const auto *found = reinterpret_cast<const Point *>(uv);
    const auto row_of = [&](int n) {
        return tangent_row(sensor_direction(R, direction[star[n]]),
                           unproject(lens, found[centroid[n]]));
    };
    *fit = {};
    Matrix<5, 5> N{};
    Vector<5> y{};
    int count = 0;
    for (int i = 0; i < stars->count; ++i) {
        double square = 0.0;
        const int nearest = nearest_of(found, centroids, tracked[i], square);
        const double own = stars->sigma_px[i];
        if (nearest < 0 || !(square <= MATCH_SIGMAS * MATCH_SIGMAS *
                                           (own * own + sigma_px[nearest] * sigma_px[nearest]))) {
            continue;
        }
        star[count] = i;
        centroid[count] = nearest;
        sigma_rad[count] = sigma_px[nearest] * pixel_rad;
        const TangentRow row = row_of(count);
        const double weight = 1 / (sigma_rad[count] * sigma_rad[count]);
        for (int axis = 0; axis < 2; ++axis) {
            for (int a = 0; a < 5; ++a) {
                y[a] += weight * row.J[axis][a] * row.z[axis];
                for (int b = 0; b < 5; ++b) {
                    N[a][b] += weight * row.J[axis][a] * row.J[axis][b];
                }
            }
        }
        ++count;
    }
    if (count < LEAST_STARS) {
        return ST_OK;
    }
    const Matrix3 P = inverse(N);
    const Vector3 turn = P * first<3>(y);
    // The attitude is eliminated from the normal equations of the lens.
    const auto across = block<2, 3>(N, 3, 0) * P;
    const auto information = block<2, 2>(N, 3, 3) - across * block<3, 2>(N, 0, 3);
    const auto taken = across * first<3>(y);
    const double lens_equations[] = {information[0][0], information[0][1], information[1][1],
                                     y[3] - taken[0], y[4] - taken[1]};
    std::copy_n(lens_equations, 5, fit->lens);
    std::copy_n(turn.element, 3, fit->turn_rad);
    std::copy_n(P.row[0], 9, fit->covariance_rad2[0]);
    fit->stars = count;
    for (int n = 0; n < count; ++n) {
        set_residual(row_of(n), sigma_rad[n], turn, P, R, direction[star[n]], residual + 2 * n);
    }
    return ST_OK;
}

}  // extern "C"

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "attitude/solution.h"

#include <cmath>

#include "attitude/triad.h"
#include "maths/jacobi.h"
#include "maths/symmetric.h"
#include "reason.h"

namespace st {
namespace {

// --- what no attitude follows from ---

/// Two stars with equal directions in image and catalogue, -1 for none.
struct Twins {
    int star = -1, twin = -1;
};

bool equal(const Vector3 &a, const Vector3 &b) {
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

Twins twins_of(const Vector3 *sensor, const Vector3 *icrf, int count) {
    for (int i = 0; i < count; ++i) {
        for (int j = 0; j < i; ++j) {
            if (equal(sensor[i], sensor[j]) && equal(icrf[i], icrf[j])) {
                return {j, i};
            }
        }
    }
    return {};
}

bool is_finite(const Vector3 &v) {
    return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]);
}

/// Return a direction as unit vector; zero stays.
Vector3 unit(const Vector3 &v) {
    // Divided by the largest first: the squares of huge or tiny ones are not numbers.
    const double largest = std::fmax(std::fmax(std::fabs(v[0]), std::fabs(v[1])), std::fabs(v[2]));
    if (!(largest > 0)) {
        return v;
    }
    const Vector3 d{{v[0] / largest, v[1] / largest, v[2] / largest}};
    const double length = norm(d);
    return {{d[0] / length, d[1] / length, d[2] / length}};
}

bool is_zero(const Vector3 &v) {
    return v[0] == 0 && v[1] == 0 && v[2] == 0;
}

/// Fill in unit vectors; return what is wrong with the input, ST_NO_REASON for nothing.
st_reason checked(const Vector3 *sensor, const Vector3 *icrf, const double *sigma_rad,
                  const Directions &stars) {
    double least = INFINITY;
    bool zero = false;
    for (int i = 0; i < stars.count; ++i) {
        if (!std::isfinite(sigma_rad[i]) || !is_finite(sensor[i]) || !is_finite(icrf[i])) {
            return reason_of(ST_REASON_STARS_NOT_FINITE, {});
        }
        least = sigma_rad[i] < least ? sigma_rad[i] : least;
        zero = zero || is_zero(sensor[i]) || is_zero(icrf[i]);
        stars.sensor[i] = unit(sensor[i]);
        stars.icrf[i] = unit(icrf[i]);
    }
    if (!(least > 0)) {
        return reason_of(ST_REASON_SIGMA_NOT_POSITIVE, {least});
    }
    if (zero) {
        return reason_of(ST_REASON_ZERO_LENGTH, {});
    }
    const Twins twins = twins_of(sensor, icrf, stars.count);
    if (twins.twin >= 0) {
        return reason_of(ST_REASON_SAME_STAR,
                         {static_cast<double>(twins.star), static_cast<double>(twins.twin)});
    }
    return {};
}

// --- Davenport's K ---

/// Return sum w icrf sensor^T.
Matrix3 attitude_profile(const Directions &stars) {
    Matrix3 B{};
    for (int n = 0; n < stars.count; ++n) {
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                B[i][j] += stars.weight[n] * stars.icrf[n][i] * stars.sensor[n][j];
            }
        }
    }
    return B;
}

// --- QUEST ---
//
// As published it finds the largest eigenvalue of Davenport's K by Newton's method from its upper
// limit, the sum of the weights, and then the Rodrigues vector, which is infinite for half turns; the
// frame is turned about an axis then. Here the frame is first turned to the TRIAD attitude of two
// stars, whatever the angle. What is left is small. So are the sums, which are written for it: they
// hold differences of directions instead of directions, and keep their digits for close stars.

// From the upper limit Newton's method never steps over the root. It doubles its digits, or halves
// its distance where two roots are one.
constexpr int MOST_STEPS = 60;
constexpr double PRECISION = 1e-15, SMALLEST = 1e-20;

/// A quaternion of any length, and the gap.
struct Remaining {
    double x, y, z, w, gap;
};

/// Return the rotation from the directions of the sensor to those that a matrix to ICRF expects.
///
/// I - K = [[g, -z], [-z^T, e]] has the eigenvalue m = 1 - lambda; the quaternion is
/// (adj(g - m) z, det(g - m)).
Remaining remaining(const Directions &stars, const Matrix3 &R) {
    Matrix3 g{};
    Vector3 z{};
    double e = 0.0;
    for (int i = 0; i < stars.count; ++i) {
        const Vector3 &b = stars.sensor[i], r = sensor_direction(R, stars.icrf[i]);
        const Vector3 d{{r[0] - b[0], r[1] - b[1], r[2] - b[2]}}, c = cross(b, d);
        const double w = stars.weight[i];
        e += w * dot(d, d) / 2;
        for (int k = 0; k < 3; ++k) {
            z[k] += w * c[k];
        }
        // 1 + b.r - 2 bx rx is 2 - 2 bx rx but for the loss e.
        g[0][0] += 2 * w * (b[1] * r[1] + b[2] * r[2]);
        g[1][1] += 2 * w * (b[0] * r[0] + b[2] * r[2]);
        g[2][2] += 2 * w * (b[0] * r[0] + b[1] * r[1]);
        g[0][1] -= w * (b[0] * r[1] + b[1] * r[0]);
        g[0][2] -= w * (b[0] * r[2] + b[2] * r[0]);
        g[1][2] -= w * (b[1] * r[2] + b[2] * r[1]);
    }
    for (int k = 0; k < 3; ++k) {
        g[k][k] += e;
    }
    double m = 0.0, x = 0.0, y = 0.0, t = 0.0, w = 0.0, slope = 0.0;
    for (int step = 0; step < MOST_STEPS; ++step) {
        Matrix3 G = g;
        for (int k = 0; k < 3; ++k) {
            G[k][k] -= m;
        }
        const Adjugate a = adjugate(G);
        x = a.xx * z[0] + a.xy * z[1] + a.xz * z[2];
        y = a.xy * z[0] + a.yy * z[1] + a.yz * z[2];
        t = a.xz * z[0] + a.yz * z[1] + a.zz * z[2];
        w = G[0][0] * a.xx + G[0][1] * a.xy + G[0][2] * a.xz;
        // p = det(I - K - m) and its slope, minus the product of the gaps to the other roots.
        const double value = (e - m) * w - (x * z[0] + y * z[1] + t * z[2]);
        const double trace = G[0][0] + G[1][1] + G[2][2];
        const double form =
            G[0][0] * z[0] * z[0] + G[1][1] * z[1] * z[1] + G[2][2] * z[2] * z[2] +
            2 * (G[0][1] * z[0] * z[1] + G[0][2] * z[0] * z[2] + G[1][2] * z[1] * z[2]);
        slope = -w - (e - m) * (a.xx + a.yy + a.zz) - form + trace * dot(z, z);
        const double change = -value / slope;
        if (!(change > PRECISION * m + SMALLEST)) {
            break;
        }
        m += change;
    }
    // The other two gaps are 2 each where one is small.
    return {x, y, t, w, -slope / 4};
}

/// Return the star with the least sigma, the first of equal ones.
int most_accurate(const double *sigma_rad, int count) {
    int first = 0;
    for (int i = 1; i < count; ++i) {
        first = sigma_rad[i] < sigma_rad[first] ? i : first;
    }
    return first;
}

// --- the four solvers ---

/// A rotation with the covariance of the solver; determinant 0 where it is not observable.
struct Fitted {
    Matrix3 R;
    Covariance covariance;
};

Fitted by_two_stars(const Directions &stars, const double *sigma_rad) {
    const StarPair pair = best_pair(stars, sigma_rad);
    // The gap of these two stars alone.
    if (pair.sine2 / 2 < MIN_GAP) {
        return {};
    }
    const int first = pair.first, second = pair.second;
    const Matrix3 R = triad(stars, first, second);
    return {R,
            {triad_covariance(sensor_direction(R, stars.icrf[first]),
                              sensor_direction(R, stars.icrf[second]), sigma_rad[first],
                              sigma_rad[second]),
             1.0}};
}

Fitted by_all_stars(st_solver solver, const Directions &stars, const double *sigma_rad,
                    double unit_variance) {
    const BestRotation best = solver == ST_QUEST       ? quest(stars, sigma_rad)
                              : solver == ST_DAVENPORT ? davenport(stars)
                                                       : svd(stars);
    if (best.gap < MIN_GAP) {
        return {};
    }
    // The catalogue is exact: its angles, not the measured ones, determine what is observable.
    Matrix3 F{};
    for (int i = 0; i < stars.count; ++i) {
        add_information(sensor_direction(best.R, stars.icrf[i]), stars.weight[i], F);
    }
    Covariance covariance = inverse_information(symmetric(F));
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            covariance.P[i][j] *= unit_variance;
        }
    }
    return {best.R, covariance};
}

}  // namespace

BestRotation svd(const Directions &stars) {
    const Singular<3> found = singular_values(attitude_profile(stars));
    // The largest two: two stars leave the third direction and its sign open.
    Vector3 left[2], right[2];
    for (int k = 0; k < 2; ++k) {
        const double scale = found.value[2 - k] > 0 ? 1 / found.value[2 - k] : 0.0;
        for (int i = 0; i < 3; ++i) {
            left[k][i] = scale * found.US[i][2 - k];
            right[k][i] = found.V[i][2 - k];
        }
    }
    const Vector3 third_left = cross(left[0], left[1]), third_right = cross(right[0], right[1]);
    // The least singular value with the sign of a mirror: where US has its column, in right-handed
    // axes.
    double least = 0.0, sign = 0.0;
    BestRotation best;
    for (int i = 0; i < 3; ++i) {
        least += third_left[i] * found.US[i][0];
        sign += third_right[i] * found.V[i][0];
        for (int j = 0; j < 3; ++j) {
            best.R[i][j] = left[0][i] * right[0][j] + left[1][i] * right[1][j] +
                           third_left[i] * third_right[j];
        }
    }
    best.gap = 2 * (found.value[1] + sign * least);
    return best;
}

BestRotation davenport(const Directions &stars) {
    const Matrix3 B = attitude_profile(stars);
    const double trace = B[0][0] + B[1][1] + B[2][2];
    Matrix<4, 4> K;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            K[i][j] = B[i][j] + B[j][i];
        }
        K[i][i] -= trace;
        K[i][3] = K[3][i] = B[(i + 2) % 3][(i + 1) % 3] - B[(i + 1) % 3][(i + 2) % 3];
    }
    K[3][3] = trace;
    const Eigen<4> found = symmetric_eigen(K);
    const Matrix<4, 4> &V = found.V;
    return {matrix_from_quaternion({V[0][3], V[1][3], V[2][3], V[3][3]}),
            found.value[3] - found.value[2]};
}

BestRotation quest(const Directions &stars, const double *sigma_rad) {
    const int first = most_accurate(sigma_rad, stars.count);
    const StarPair pair = best_partner(stars, sigma_rad, first);
    if (!(pair.sine2 > 0)) {
        return {identity<3>(), 0.0};
    }
    const Matrix3 start = triad(stars, first, pair.second);
    // The two stars may contradict the others. Then the rest is a half turn at worst, and the frame
    // is turned about its axes. In one of the four frames cos(angle / 2)^2 is 1/4 or more.
    BestRotation best{};
    for (int axis = -1; axis < 3; ++axis) {
        best.R = start;
        for (int k = 0; k < 3; ++k) {
            if (axis >= 0 && k != axis) {
                for (int i = 0; i < 3; ++i) {
                    best.R[i][k] = -best.R[i][k];
                }
            }
        }
        const auto [x, y, z, w, gap] = remaining(stars, best.R);
        best.gap = gap;
        if (w != 0 && 5 * w * w > x * x + y * y + z * z + w * w) {
            best.R = turn_matrix(best.R, {{x / w, y / w, z / w}});
            break;
        }
    }
    return best;
}

Solution solve(st_solver solver, const Vector3 *sensor, const Vector3 *icrf,
               const double *sigma_rad, int count, Arena &arena) {
    const auto n = static_cast<size_t>(count);
    Solution solution{};
    solution.stars = count;
    solution.residual_rad = arena.take<double>(n);
    const Arena::Scope scope(arena);
    const Directions stars{count, arena.take<Vector3>(n), arena.take<Vector3>(n),
                           arena.take<double>(n)};
    if (count < 2) {
        solution.reason = reason_of(ST_REASON_TOO_FEW_STARS, {static_cast<double>(count), 2.0});
        return solution;
    }
    solution.reason = checked(sensor, icrf, sigma_rad, stars);
    if (solution.reason.code != ST_NO_REASON) {
        return solution;
    }
    const double least = sigma_rad[most_accurate(sigma_rad, count)];
    double total = 0.0;
    for (int i = 0; i < count; ++i) {
        const double ratio = least / sigma_rad[i];
        stars.weight[i] = ratio * ratio;
        total += stars.weight[i];
    }
    for (int i = 0; i < count; ++i) {
        stars.weight[i] /= total;
    }
    const Fitted fitted = solver == ST_TRIAD
                              ? by_two_stars(stars, sigma_rad)
                              : by_all_stars(solver, stars, sigma_rad, least * least / total);
    if (!(fitted.covariance.determinant > 0)) {
        solution.reason = reason_of(ST_REASON_PARALLEL, {});
        return solution;
    }
    solution.quaternion = quaternion_from_matrix(fitted.R);
    solution.covariance = fitted.covariance.P;
    for (int i = 0; i < count; ++i) {
        const double away =
            angle_between(stars.sensor[i], sensor_direction(fitted.R, stars.icrf[i]));
        solution.residual_rad[i] = away;
        solution.chi2 += away / sigma_rad[i] * (away / sigma_rad[i]);
    }
    return solution;
}

size_t solve_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return 2 * (Arena::padded<double>(n) + Arena::padded<Vector3>(n));
}

Covariance cramer_rao(const Vector3 *sensor, const double *sigma_rad, int count) {
    const double least = sigma_rad[most_accurate(sigma_rad, count)];
    Matrix3 F{};
    for (int i = 0; i < count; ++i) {
        const double ratio = least / sigma_rad[i];
        add_information(sensor[i], ratio * ratio, F);
    }
    Covariance covariance = inverse_information(symmetric(F));
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            covariance.P[i][j] *= least * least;
        }
    }
    return covariance;
}

double mean_chi2(const Solution &solution, const Vector3 *icrf, const double *sigma_rad) {
    const Matrix3 P = covariance_icrf(solution.quaternion, solution.covariance);
    const double trace = P[0][0] + P[1][1] + P[2][2];
    double sum = 0.0;
    for (int i = 0; i < solution.stars; ++i) {
        sum += (trace - dot(icrf[i], P * icrf[i])) / (sigma_rad[i] * sigma_rad[i]);
    }
    return 2 * solution.stars - 6 + sum;
}

}  // namespace st

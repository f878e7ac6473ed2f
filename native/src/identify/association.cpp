// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/association.h"

#include <cmath>
#include <cstring>

#include "sky/near.h"

namespace st {
namespace {

constexpr int LEAST_MATCHED = 4, MOST_ATTEMPTS = 5;
// The first radius allows for the attitude that close stars extrapolate; used twice, because the
// stars found first lead to those at the far side of the image.
constexpr int WIDE_ATTEMPTS = 2;
constexpr double WIDE = 3.0;
// Attitude and focal length are fitted in turn, which converges by a factor of ten a step or more.
constexpr int FIT_STEPS = 20;
constexpr double CONVERGED_RATIO = 1e-9;

/// Return the distance of a star from a point of the fitted focal length.
double distance(bool equidistant, const Matrix3 &R, const double *direction, const Point &at) {
    const Point star = seen_at(equidistant, R, direction);
    const double da = star.x - at.x, db = star.y - at.y;
    return std::sqrt(da * da + db * db);
}

/// Associate each image star with the nearest catalogue star. One to one: of several image stars
/// at one star the nearest is associated.
void associate(const Patterns &sky, bool equidistant, const ImageStars &stars, double radius,
               StarMatch &found) {
    for (int i = 0; i < stars.count; ++i) {
        found.star[i] = -1;
        found.residual[i] = NAN;
        const Point at{stars.seen[i].x / found.focal_ratio, stars.seen[i].y / found.focal_ratio};
        int32_t star =
            nearest(sky.cells, sky.direction, found.R * ray(equidistant, at), radius).star;
        if (star < 0) {
            continue;
        }
        const double residual = distance(equidistant, found.R, sky.direction[star], at);
        // A star that cannot be seen has the residual NaN.
        if (!(residual <= radius)) {
            continue;
        }
        for (int other = 0; other < i; ++other) {
            if (found.star[other] == star) {
                if (found.residual[other] <= residual) {
                    star = -1;
                } else {
                    found.star[other] = -1;
                    found.residual[other] = NAN;
                }
                break;
            }
        }
        if (star >= 0) {
            found.star[i] = star;
            found.residual[i] = residual;
        }
    }
}

/// Put the directions of the associated stars, seen with the fitted focal length, into a list.
void collect(const Patterns &sky, bool equidistant, const ImageStars &stars,
             const StarMatch &found, Directions &matched) {
    matched.count = 0;
    if (matched.sensor == nullptr || matched.icrf == nullptr || matched.weight == nullptr) {
        return;  // work_bytes() leaves memory for them
    }
    for (int i = 0; i < stars.count; ++i) {
        if (found.star[i] < 0) {
            continue;
        }
        const double *direction = sky.direction[found.star[i]];
        const int row = matched.count++;
        matched.sensor[row] = ray(equidistant, {stars.seen[i].x / found.focal_ratio,
                                                stars.seen[i].y / found.focal_ratio});
        matched.icrf[row] = {{direction[0], direction[1], direction[2]}};
        matched.weight[row] = 1 / (stars.sigma[i] * stars.sigma[i]);
    }
}

/// Return the direction that is farthest from the first.
int farthest(const Directions &matched) {
    int found = 0;
    double most = -1.0;
    for (int i = 1; i < matched.count; ++i) {
        double chord2 = 0.0;
        for (int k = 0; k < 3; ++k) {
            const double d = matched.sensor[i][k] - matched.sensor[0][k];
            chord2 += d * d;
        }
        if (chord2 > most) {
            found = i;
            most = chord2;
        }
    }
    return found;
}

/// Return the focal length that fits over the one of the sensor directions.
///
/// With p_i the seen and q_i the predicted undistorted coordinates, and p, q their means, it is the
/// least-squares scale sum (p_i - p) . (q_i - q) / sum |q_i - q|^2. About the means and not about
/// the axis: else stars on one side of the image would hide a wrong scale in a wrong attitude.
double focal_ratio(bool equidistant, const Matrix3 &R, const Directions &matched, Point *p,
                   Point *q) {
    Point p_mean{0.0, 0.0}, q_mean{0.0, 0.0};
    for (int i = 0; i < matched.count; ++i) {
        q[i] = plane_point(equidistant, sensor_direction(R, matched.icrf[i]));
        p[i] = plane_point(equidistant, matched.sensor[i]);
        p_mean = {p_mean.x + p[i].x / matched.count, p_mean.y + p[i].y / matched.count};
        q_mean = {q_mean.x + q[i].x / matched.count, q_mean.y + q[i].y / matched.count};
    }
    double pq = 0.0, qq = 0.0;
    for (int i = 0; i < matched.count; ++i) {
        const double dx = q[i].x - q_mean.x, dy = q[i].y - q_mean.y;
        pq += (p[i].x - p_mean.x) * dx;
        qq += dx * dx;
        pq += (p[i].y - p_mean.y) * dy;
        qq += dy * dy;
    }
    return pq / qq;
}

/// Return sqrt(sum |p_i - p|^2) of the associated image stars p_i, p their mean.
double scatter(const ImageStars &stars, const StarMatch &found) {
    int count = 0;
    double x = 0.0, y = 0.0, xx = 0.0, yy = 0.0;
    for (int i = 0; i < stars.count; ++i) {
        if (found.star[i] >= 0) {
            ++count;
            x += stars.seen[i].x;
            y += stars.seen[i].y;
            xx += stars.seen[i].x * stars.seen[i].x;
            yy += stars.seen[i].y * stars.seen[i].y;
        }
    }
    const double square = xx + yy - (x * x + y * y) / count;
    return std::sqrt(square > 0.0 ? square : 0.0);
}

/// Set the residuals of an association again; return the largest.
double update(const Patterns &sky, bool equidistant, const ImageStars &stars, StarMatch &found) {
    double largest = 0.0;
    for (int i = 0; i < stars.count; ++i) {
        if (found.star[i] >= 0) {
            const Point at{stars.seen[i].x / found.focal_ratio,
                           stars.seen[i].y / found.focal_ratio};
            const double d = distance(equidistant, found.R, sky.direction[found.star[i]], at);
            found.residual[i] = d;
            largest = d > largest ? d : largest;
        }
    }
    return largest;
}

Directions directions(int most, Arena &work) {
    const auto capacity = static_cast<size_t>(most);
    return {0, work.take<Vector3>(capacity), work.take<Vector3>(capacity),
            work.take<double>(capacity)};
}

/// Fit attitude and focal length to an association, in turn, by at most so many steps; return the
/// fitted ratio, beyond scale_error too, NaN where the attitude is not observable.
double fit(const Patterns &sky, bool equidistant, const ImageStars &stars, double scale_error,
           int most_steps, Directions &matched, StarMatch &found, Arena &work) {
    const Arena::Scope scope(work);
    const auto capacity = static_cast<size_t>(stars.count);
    auto *p = work.take<Point>(capacity), *q = work.take<Point>(capacity);
    double fitted = NAN;
    for (int step = 0; step < most_steps; ++step) {
        collect(sky, equidistant, stars, found, matched);
        if (!(refine(found.R, matched, most_steps).determinant > 0)) {
            return NAN;
        }
        const double before = found.focal_ratio;
        fitted = before * focal_ratio(equidistant, found.R, matched, p, q);
        // Close stars may determine the scale less well than it was known before.
        found.focal_ratio = std::fmin(std::fmax(fitted, 1 - scale_error), 1 + scale_error);
        if (std::fabs(found.focal_ratio - before) < CONVERGED_RATIO) {
            break;
        }
    }
    return fitted;
}

}  // namespace

StarMatch star_match(int most, Arena &arena) {
    const auto capacity = static_cast<size_t>(most);
    return {arena.take<int32_t>(capacity), arena.take<double>(capacity), 1.0, identity<3>()};
}

void copy(const StarMatch &from, int count, StarMatch &to) {
    const auto items = static_cast<size_t>(count);
    std::memcpy(to.star, from.star, items * sizeof(int32_t));
    std::memcpy(to.residual, from.residual, items * sizeof(double));
    to.focal_ratio = from.focal_ratio;
    to.R = from.R;
}

int count_matched(const StarMatch &found, int count) {
    int matched = 0;
    for (int i = 0; i < count; ++i) {
        matched += found.star[i] >= 0;
    }
    return matched;
}

bool align(const Patterns &sky, bool equidistant, const ImageStars &stars, const int32_t *base,
           const int32_t *star, int based, double radius, double scale_error, StarMatch &found,
           Arena &work) {
    const Arena::Scope scope(work);
    const auto capacity = static_cast<size_t>(stars.count);
    auto *before = work.take<int32_t>(capacity);
    Directions matched = directions(stars.count, work);
    for (int i = 0; i < stars.count; ++i) {
        found.star[i] = -1;
        found.residual[i] = NAN;
    }
    for (int i = 0; i < based; ++i) {
        found.star[base[i]] = star[i];
    }
    found.R = identity<3>();
    found.focal_ratio = 1.0;
    collect(sky, equidistant, stars, found, matched);
    found.R = triad(matched, 0, farthest(matched));
    // First the scale of the base alone: where that is off, so is the attitude. What one step leaves
    // is small compared with the radius, and more steps follow.
    double fitted = fit(sky, equidistant, stars, scale_error, 1, matched, found, work);
    for (int attempt = 1; attempt < MOST_ATTEMPTS; ++attempt) {
        std::memcpy(before, found.star, capacity * sizeof(int32_t));
        fitted = fit(sky, equidistant, stars, scale_error, 1, matched, found, work);
        if (std::isnan(fitted)) {
            return false;
        }
        associate(sky, equidistant, stars, attempt > WIDE_ATTEMPTS ? radius : WIDE * radius,
                  found);
        if (count_matched(found, stars.count) < LEAST_MATCHED) {
            return false;
        }
        if (attempt > 1 && std::memcmp(before, found.star, capacity * sizeof(int32_t)) == 0) {
            // The same stars: their best fit does not depend on the triangle that has led to them.
            fitted = fit(sky, equidistant, stars, scale_error, FIT_STEPS, matched, found, work);
            // A narrower radius would leave it as it is.
            if (update(sky, equidistant, stars, found) <= radius) {
                break;
            }
        }
    }
    return std::fabs(fitted - 1) <= scale_error + radius / scatter(stars, found);
}

AttitudeFit fit_attitude(const Patterns &sky, bool equidistant, const ImageStars &stars,
                         const StarMatch &found, double *angle_rad, Arena &work) {
    const Arena::Scope scope(work);
    Directions matched = directions(stars.count, work);
    collect(sky, equidistant, stars, found, matched);
    for (int i = 0; i < stars.count; ++i) {
        angle_rad[i] = found.star[i] >= 0 ? 0.0 : NAN;
    }
    Matrix3 R = found.R, unknown;
    for (auto &row : unknown.row) {
        row[0] = row[1] = row[2] = INFINITY;
    }
    if (matched.count < 2) {
        return {{0.0, 0.0, 0.0, 0.0}, unknown, INFINITY};
    }
    const Covariance covariance = refine(R, matched, CONVERGED_STEPS);
    double chi2 = 0.0;
    for (int i = 0, row = 0; i < stars.count; ++i) {
        if (found.star[i] >= 0) {
            angle_rad[i] =
                angle_between(matched.sensor[row], sensor_direction(R, matched.icrf[row]));
            chi2 += angle_rad[i] * angle_rad[i] * matched.weight[row];
            ++row;
        }
    }
    return {quaternion_from_matrix(R), covariance.determinant > 0 ? covariance.P : unknown, chi2};
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/start.h"

#include <algorithm>
#include <cmath>

#include "attitude/error_ellipses.h"
#include "attitude/pointing.h"
#include "integrity/checks.h"
#include "maths/symmetric.h"

namespace st {
namespace {

constexpr double DEG = M_PI / 180;
constexpr double MAX_SIGMA_RAD = limit(checks::HINT, "sigma_deg") * DEG;
constexpr double MAX_RATE_SIGMA_RAD_S = limit(checks::HINT, "rate_sigma_deg_s") * DEG;
constexpr double RATE_FLOOR_RAD_S = 0.05 * DEG;

/// Return x^T A^-1 x of a symmetric A, positive definite.
double squared_distance(const Vector3 &x, const Matrix3 &A) {
    return dot(x, inverse(A) * x);
}

Matrix3 times(const Matrix3 &A, double factor) {
    Matrix3 product;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            product[i][j] = factor * A[i][j];
        }
    }
    return product;
}

double trace(const Matrix3 &A) {
    return A[0][0] + A[1][1] + A[2][2];
}

}  // namespace

size_t identified_frame_bytes(int capacity) {
    const auto n = static_cast<size_t>(capacity);
    return Arena::padded<int32_t>(n) + Arena::padded<st_centroid>(n);
}

IdentifiedFrame frame_for(int capacity, Arena &arena) {
    const auto n = static_cast<size_t>(capacity);
    IdentifiedFrame frame{};
    frame.star = arena.list<int32_t>(n);
    frame.centroid = arena.list<st_centroid>(n);
    return frame;
}

void copy_frame(const IdentifiedFrame &from, IdentifiedFrame &to) {
    const List<int32_t> star = to.star;
    const List<st_centroid> centroid = to.centroid;
    to = from;
    to.star = star;
    to.centroid = centroid;
    to.star.clear();
    to.centroid.clear();
    to.star.add_all(from.star);
    to.centroid.add_all(from.centroid);
}

size_t fit_identified_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return Arena::padded<int32_t>(n) + Arena::padded<int>(n) + Arena::padded<Vector3>(n) +
           Arena::padded<Point>(n) + Arena::padded<double>(n) + Arena::padded<Covariance2>(n) +
           2 * Arena::padded<bool>(n) + rotation_fit_bytes(count) +
           std::max(rotation_fit_work_bytes(count), error_ellipses_bytes(count));
}

bool fit_identified(const Lens &lens, const ApparentSky &sky, const st_tracking_options &options,
                    int64_t stamp_ns, const st_centroid *centroids, const int32_t *hip, int count,
                    IdentifiedFrame &frame, st_reason &reason, Arena &work) {
    const Arena::Scope scope(work);
    const auto n = static_cast<size_t>(count);
    reason = reason_of(ST_NO_REASON, {});
    frame.star.clear();
    frame.centroid.clear();
    // Which centroid each star of the fit has.
    auto *star = work.take<int32_t>(n);
    auto *of = work.take<int>(n);
    int stars = 0;
    for (int j = 0; j < count; ++j) {
        const int32_t found = hip[j] > 0 ? star_of_hip(sky, hip[j]) : -1;
        if (found >= 0 && !is_crowded(sky, found) &&
            std::find(star, star + stars, found) == star + stars) {
            star[stars] = found;
            of[stars++] = j;
        }
    }
    if (stars < options.min_stars) {
        return false;
    }
    auto *icrf = work.take<Vector3>(n);
    auto *uv = work.take<Point>(n);
    auto *sigma_px = work.take<double>(n);
    auto *error = work.take<Covariance2>(n);
    auto *candidate = work.take<bool>(n);
    const double floor_px2 = options.sigma_floor_px * options.sigma_floor_px;
    for (int i = 0; i < stars; ++i) {
        const st_centroid &centroid = centroids[of[i]];
        icrf[i] = apparent_direction(sky, star[i]);
        uv[i] = {centroid.u_px, centroid.v_px};
        error[i] = error_of(centroid, floor_px2);
        sigma_px[i] = std::sqrt((error[i].uu + error[i].vv) / 2);
        candidate[i] = true;
    }
    RotationFit fit = rotation_fit_for(stars, work);
    if (!fit_rotation(lens, icrf, uv, sigma_px, candidate, ST_QUEST, fit, work)) {
        return false;
    }
    if (!is_good(fit.attitude.stars, stars, fit.residual_px, options.min_stars,
                 options.max_residual_px)) {
        if (fit.residual_px > options.max_residual_px) {
            reason = reason_of(checks::MISFIT, {static_cast<double>(stars), fit.residual_px,
                                                options.max_residual_px});
        }
        return false;
    }
    int kept = 0;
    for (int i = 0; i < stars; ++i) {
        if (fit.inlier[i]) {
            frame.star.add(star[i]);
            frame.centroid.add(centroids[of[i]]);
            icrf[kept] = icrf[i];
            uv[kept] = uv[i];
            error[kept++] = error[i];
        }
    }
    fit_error_ellipses(lens, uv, error, icrf, fit.attitude, work);
    frame.stamp_ns = stamp_ns;
    frame.quaternion = fit.attitude.quaternion;
    frame.covariance =
        fit.attitude.covariance +
        pointing_covariance(lens, correlated_error(frame.centroid.item, frame.centroid.count),
                            nullptr);
    frame.scale = fit.scale;
    return true;
}

bool contradicts(const IdentifiedFrame &frame, const Quaternion &tracked,
                 const Matrix3 &tracked_covariance, const Lens &lens, const ApparentSky &sky,
                 double max_residual_px) {
    const Vector3 error = attitude_error(frame.quaternion, tracked);
    const double distance2 = squared_distance(error, frame.covariance + tracked_covariance);
    const Matrix3 R = matrix_from_quaternion(tracked);
    double square = 0.0;
    for (int i = 0; i < frame.star.count; ++i) {
        const Point uv =
            project(lens, sensor_direction(R, apparent_direction(sky, frame.star[i])));
        const double du = uv.x - frame.centroid[i].u_px, dv = uv.y - frame.centroid[i].v_px;
        square += du * du + dv * dv;
    }
    const double rms_px = std::sqrt(square / frame.star.count);
    return distance2 > checks::IDENTIFICATION_DIFFERS.threshold &&
           !(rms_px <= limit(checks::IDENTIFICATION_DIFFERS, "residual_ratio") * max_residual_px);
}

// --- starts ---

Start start_of_two(const IdentifiedFrame &first, const IdentifiedFrame &second) {
    const double dt_s = static_cast<double>(second.stamp_ns - first.stamp_ns) * 1e-9;
    const Matrix3 after = times(second.covariance, second.scale * second.scale);
    const Matrix3 before = times(first.covariance, first.scale * first.scale);
    return {&second,
            scaled(rotation_between(first.quaternion, second.quaternion), 1 / dt_s),
            times(after + before, 1 / (dt_s * dt_s)),
            times(after, 1 / dt_s),
            reason_of(ST_REASON_IDENTIFIED_TWICE, {static_cast<double>(second.star.count)}),
            false};
}

namespace {

/// Whether no axis of a covariance has a larger standard deviation.
bool is_within(const Matrix3 &covariance, double sigma) {
    const double most = sigma * sigma;
    // The trace is at least the largest eigenvalue.
    if (trace(covariance) <= most) {
        return true;
    }
    // sigma^2 I - P has no negative eigenvalue: neither has any principal minor.
    const Matrix3 rest = times(identity<3>(), most) - covariance;
    return rest[0][0] >= 0 && rest[1][1] >= 0 && rest[2][2] >= 0 &&
           rest[0][0] * rest[1][1] - rest[0][1] * rest[0][1] >= 0 &&
           rest[0][0] * rest[2][2] - rest[0][2] * rest[0][2] >= 0 &&
           rest[1][1] * rest[2][2] - rest[1][2] * rest[1][2] >= 0 && determinant(rest) >= 0;
}

/// Fill in the start at a frame that agrees with an attitude; false without one.
bool confirmed(const st_hint &hint, const IdentifiedFrame &frame, bool hinted, Start &start) {
    Matrix3 covariance, rate_covariance;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            covariance[i][j] = hint.covariance_rad2[i][j];
            rate_covariance[i][j] = hint.rate_covariance[i][j];
        }
    }
    if (!(is_within(covariance, MAX_SIGMA_RAD) &&
          is_within(rate_covariance, MAX_RATE_SIGMA_RAD_S))) {
        return false;
    }
    if (hinted) {
        rate_covariance =
            rate_covariance + times(identity<3>(), RATE_FLOOR_RAD_S * RATE_FLOOR_RAD_S);
    }
    const double dt_s = static_cast<double>(frame.stamp_ns - hint.stamp_ns) * 1e-9;
    const Vector3 rate_rad_s = {{hint.rate_rad_s[0], hint.rate_rad_s[1], hint.rate_rad_s[2]}};
    const double *q = hint.quaternion;
    const Quaternion expected = turned({q[0], q[1], q[2], q[3]}, scaled(rate_rad_s, dt_s));
    const Matrix3 S = covariance + times(frame.covariance, frame.scale * frame.scale) +
                      times(rate_covariance, dt_s * dt_s);
    if (squared_distance(rotation_between(expected, frame.quaternion), S) >
        checks::HINT_DIFFERS.threshold) {
        return false;
    }
    const int32_t code = hinted ? ST_REASON_HINT_AGREES : ST_REASON_PREDICTION_AGREES;
    start = {&frame,
             rate_rad_s,
             rate_covariance,
             {},
             reason_of(code, {static_cast<double>(frame.star.count)}),
             hinted};
    return true;
}

}  // namespace

bool start_of_prediction(const st_hint &predicted, const IdentifiedFrame &frame, Start &start) {
    return confirmed(predicted, frame, false, start);
}

void add_hint(const st_hint &hint, HintedStart &hints) {
    hints.newest = hint;
    hints.is_there = true;
}

bool start_of_hint(const HintedStart &hints, const IdentifiedFrame &frame, double max_gap_s,
                   Start &start) {
    const double away_s = static_cast<double>(frame.stamp_ns - hints.newest.stamp_ns) * 1e-9;
    return hints.is_there && !hints.ignored && !(std::fabs(away_s) > max_gap_s) &&
           confirmed(hints.newest, frame, true, start);
}

void note_start(bool hinted, HintedStart &hints) {
    hints.used = hinted;
    hints.ignored = hints.ignored && hints.used;
}

void note_loss(int good_frames, HintedStart &hints) {
    hints.ignored = hints.ignored || (hints.used && good_frames < checks::HINT_FAILED.frames);
    hints.used = false;
}

}  // namespace st

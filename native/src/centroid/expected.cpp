// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/expected.h"

#include <cmath>

#include "centroid/windowed_search.h"
#include "maths/matrix.h"

namespace st {
namespace {

constexpr double GATE_SIGMAS = 4.0;
constexpr double GATE_PX = 2.0;       // for accelerations that a prediction does not know
constexpr double MOST_GATE_PX = 8.0;  // of a star
// Of a target; the whole image is searched for one that may be further away.
constexpr double MOST_TARGET_PX = MOST_RADIUS_OF_SEARCH_PX;
constexpr double MOST_ASTRAY = 0.5, MOST_ASTRAY_PX = 2.0;  // of a streak, across the motion
constexpr double MOST_EXPOSURE = 1.2;  // of the interval between images, with its estimate's error

/// Return the motion of the middle of an image in px, and of its corner by the roll.
Vector3 motion_px(const Streak &streak) {
    return {{streak.u_px, streak.v_px, std::hypot(streak.u0, streak.v0) * streak.roll}};
}

}  // namespace

int Predictions::stars() const {
    int stars = 0;
    while (stars < count && item[stars].hip != 0) {
        ++stars;
    }
    return stars;
}

int Expected::stars_seen(const List<st_centroid> &centroids) const {
    int seen = 0;
    for (int i = 0; i < stars; ++i) {
        for (const st_centroid &one : centroids) {
            const double u = one.u_px - places[i].u, v = one.v_px - places[i].v;
            if (u * u + v * v < MOST_GATE_PX * MOST_GATE_PX) {
                ++seen;
                break;
            }
        }
    }
    return seen;
}

double Expected::exposure_s(const Streak &streak) const {
    if (!agrees(streak)) {
        return 0.0;
    }
    const double exposure_s = std::fabs(seconds(streak));
    return exposure_s < MOST_EXPOSURE * interval_s ? exposure_s : 0.0;
}

bool Expected::agrees(const Streak &streak) const {
    const Vector3 seen = motion_px(streak);
    const double length = MOST_ASTRAY * norm(seen);
    const Vector3 along = st::scaled(motion_px(motion), seconds(streak));
    double square = 0.0;
    for (int i = 0; i < 3; ++i) {
        square += (seen[i] - along[i]) * (seen[i] - along[i]);
    }
    return std::sqrt(square) < (length > MOST_ASTRAY_PX ? length : MOST_ASTRAY_PX);
}

/// Return the time in which the motion comes nearest to a streak, or its opposite.
double Expected::seconds(const Streak &streak) const {
    const Vector3 moved = motion_px(motion);
    const double square = dot(moved, moved);
    return dot(motion_px(streak), moved) / (square > 1e-9 ? square : 1e-9);
}

Expected expected_at(int64_t stamp_ns, const Predictions &predicted, int width, int height,
                     double interval_s, Arena &arena) {
    const auto count = static_cast<size_t>(predicted.count);
    Expected expected{arena.take<Place>(count),
                      arena.take<double>(count),
                      0,
                      predicted.stars(),
                      false,
                      {},
                      0.0,
                      interval_s};
    const Arena::Scope scope(arena);
    const auto stars = static_cast<size_t>(expected.stars);
    auto *at = arena.take<Place>(stars), *velocity = arena.take<Place>(stars);
    auto *weight = arena.take<double>(stars);
    const double dt_s = static_cast<double>(stamp_ns - predicted.stamp_ns) * 1e-9;
    const double cell = predicted.cell, shift = (cell - 1) / 2;
    double square = 0.0;
    for (int i = 0; i < predicted.count; ++i) {
        const st_prediction &one = predicted.item[i];
        const Place place{(one.u_px - shift) / cell, (one.v_px - shift) / cell};
        const Place rate{one.u_rate_px_s / cell, one.v_rate_px_s / cell};
        double radius_px = GATE_SIGMAS * (one.sigma_px / cell) + GATE_PX;
        if (i < expected.stars) {
            radius_px = radius_px < MOST_GATE_PX ? radius_px : MOST_GATE_PX;
            const double speed = rate.u * rate.u + rate.v * rate.v;
            square = speed > square ? speed : square;
            at[i] = place;
            velocity[i] = rate;
            weight[i] = 1.0;
        }
        if (radius_px <= MOST_TARGET_PX) {
            expected.places[expected.count] = {place.u + rate.u * dt_s, place.v + rate.v * dt_s};
            expected.radius_px[expected.count++] = radius_px;
        }
    }
    expected.anywhere = expected.count < predicted.count;
    expected.motion = fit_streak(at, velocity, weight, expected.stars, width, height);
    expected.speed_px_s = std::sqrt(square);
    return expected;
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/frame_motion.h"

#include <algorithm>
#include <cmath>

#include "maths/sorting.h"
#include "track/motion_models.h"

namespace st {
namespace {

constexpr int BRIGHTEST = 30;
constexpr double MOST_RATE_RAD_S = 20.0 * M_PI / 180;
constexpr double LONGEST_S = 1.0;
constexpr double FLUX_RATIO = 1.6;  // between two frames of a star
constexpr double RADIUS_PX = 8.0;   // within which stars of a camera that rolls move alike
constexpr int LEAST_STARS = 6;
constexpr double OUTLIER_PX = 1.0;

/// A centroid of each frame, and the displacement between them.
struct Pair {
    const st_centroid *before, *after;
    Point shift;
    Flow design;  // image motion per body rate times the time between them
};

/// Put the brightest centroids in front; return how many there are.
int brightest(const st_centroid *centroids, int count, const st_centroid **chosen,
              const st_centroid **spare) {
    for (int i = 0; i < count; ++i) {
        chosen[i] = &centroids[i];
    }
    sort(chosen, count, spare,
         [](const st_centroid *a, const st_centroid *b) { return a->flux_dn > b->flux_dn; });
    return std::min(count, BRIGHTEST);
}

bool are_near(const Pair &one, const Pair &other) {
    const double du = other.shift.x - one.shift.x, dv = other.shift.y - one.shift.y;
    return std::sqrt(du * du + dv * dv) < RADIUS_PX;
}

/// Keep the pairs whose displacements are near that which most pairs share; return how many.
int most_alike(Pair *pairs, int count) {
    int best = 0, most = 0;
    for (int i = 0; i < count; ++i) {
        int alike = 0;
        for (int k = 0; k < count; ++k) {
            alike += are_near(pairs[i], pairs[k]) ? 1 : 0;
        }
        if (alike > most) {
            most = alike;
            best = i;
        }
    }
    const Pair chosen = pairs[best];
    return static_cast<int>(
        std::remove_if(pairs, pairs + count,
                       [&](const Pair &one) { return !are_near(chosen, one); }) -
        pairs);
}

/// Fit the rate, without outliers, one at a time; false where too few are left.
bool fit_rate(Pair *pairs, int count, Vector3 &rate_rad_s) {
    while (count >= LEAST_STARS) {
        NormalEquations3 sums{};
        Matrix3 covariance;
        for (int i = 0; i < count; ++i) {
            sums.add(pairs[i].design, {pairs[i].shift, round_error(1.0)}, 1.0);
        }
        if (!body_rate(sums, rate_rad_s, covariance)) {
            return false;
        }
        int worst = 0;
        double most_px = -1.0;
        for (int i = 0; i < count; ++i) {
            const Point moved = velocity_of(pairs[i].design, rate_rad_s);
            const double du = moved.x - pairs[i].shift.x, dv = moved.y - pairs[i].shift.y;
            const double off_px = std::sqrt(du * du + dv * dv);
            if (off_px > most_px) {
                most_px = off_px;
                worst = i;
            }
        }
        if (most_px <= OUTLIER_PX) {
            return true;
        }
        std::copy(pairs + worst + 1, pairs + count, pairs + worst);
        --count;
    }
    return false;
}

}  // namespace

size_t frame_motion_bytes(int before_count, int after_count) {
    return 2 * Arena::padded<st_centroid *>(static_cast<size_t>(before_count)) +
           2 * Arena::padded<st_centroid *>(static_cast<size_t>(after_count)) +
           Arena::padded<Pair>(BRIGHTEST * BRIGHTEST);
}

bool rate_between_frames(const Lens &lens, const st_centroid *before, int before_count,
                         const st_centroid *after, int after_count, double dt_s,
                         Vector3 &rate_rad_s, Arena &work) {
    if (!(0 < dt_s && dt_s <= LONGEST_S)) {
        return false;
    }
    const Arena::Scope scope(work);
    const auto n = static_cast<size_t>(before_count), m = static_cast<size_t>(after_count);
    auto **first = work.take<const st_centroid *>(n), **second = work.take<const st_centroid *>(m);
    const int firsts = brightest(before, before_count, first, work.take<const st_centroid *>(n));
    const int seconds = brightest(after, after_count, second, work.take<const st_centroid *>(m));
    const double reach_px = MOST_RATE_RAD_S * dt_s * std::sqrt(lens.fx * lens.fy) + RADIUS_PX;
    auto *pairs = work.take<Pair>(BRIGHTEST * BRIGHTEST);
    int count = 0;
    for (int i = 0; i < firsts; ++i) {
        for (int j = 0; j < seconds; ++j) {
            const double du = second[j]->u_px - first[i]->u_px;
            const double dv = second[j]->v_px - first[i]->v_px;
            const double ratio = std::log(second[j]->flux_dn / first[i]->flux_dn);
            if (std::fabs(ratio) < std::log(FLUX_RATIO) &&
                std::sqrt(du * du + dv * dv) < reach_px) {
                pairs[count++] = {first[i], second[j], {du, dv}, {}};
            }
        }
    }
    if (count < LEAST_STARS) {
        return false;
    }
    count = most_alike(pairs, count);
    for (int i = 0; i < count; ++i) {
        const st_centroid &begin = *pairs[i].before, &end = *pairs[i].after;
        const double time_s = dt_s + end.delay_s - begin.delay_s;
        const Point middle = {(begin.u_px + end.u_px) / 2, (begin.v_px + end.v_px) / 2};
        const Flow J = flow_of(lens, unproject(lens, middle));
        for (int axis = 0; axis < 3; ++axis) {
            pairs[i].design[0][axis] = J[0][axis] * time_s;
            pairs[i].design[1][axis] = J[1][axis] * time_s;
        }
    }
    return fit_rate(pairs, count, rate_rad_s);
}

}  // namespace st

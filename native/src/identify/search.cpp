// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/search.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "identify/false_alarm.h"

namespace st {
namespace {

// Expected time in ns, as the costs of triangle_order.h: for each image star to predict it from a
// triangle, and to verify a candidate.
constexpr double PREDICTION_COST_NS = 30.0, VERIFICATION_COST_NS = 250.0;
// q: a triangle of true stars finds its field in so many cases at least. The others have a larger
// error, or less support than a chance one.
constexpr double FINDS = 0.5;
// W: to find a field is worth so much work.
constexpr double WORTH_NS = 6e9;
// Whether to end is looked at after so many triangles.
constexpr int LOOK_PERIOD = 16;
// A poor field has as few stars as one of ten, which is the easiest to accept, a rich one as many.
constexpr int EXTREME = 10;
// After so much work it is seen whether the caller has stopped the search.
constexpr double STOP_PERIOD_NS = 3e5;

}  // namespace

/// Of the N = C(n, 3) triangles K_m = C(m, 3) are of true stars alone if m of the n stars are true.
/// Any m up to M is assumed to be as probable as any other: n, or the stars of a rich field. Those
/// that could be accepted begin with m_0, in a poor field. After t triangles the field is not found
/// yet with (1 - q t / N)^K_m, so that the next one finds it with the probability
///
///     h = 1 / M sum_{m = m_0}^M q K_m / N (1 - q t / N)^(K_m - 1).
///
/// It takes the work c: the search ends when h W < c.
bool is_searched(const Verifier &verifier, double median_sigma, int count, double looked_up,
                 double cost_ns, double tested, double false_alarm_max) {
    const double n = count, r = verifier.tolerance_sigmas * median_sigma;
    const int few = verifier.samples / EXTREME;
    const int32_t poor = std::max(verifier.counts[few], 1);
    const int32_t M = std::min(count, verifier.counts[verifier.samples - few]);
    const double p = std::fmin(1.0, poor * M_PI * r * r / verifier.field.area);
    const double per_triangle = FINDS / (n * (n - 1) * (n - 2) / 6);
    const double left = std::log(1 - looked_up * per_triangle);
    double h = 0.0;
    for (int m = least_matches(count, p, 1.0 / EXTREME, 3, verifier.tolerance_sigmas, tested,
                               false_alarm_max);
         m <= M; ++m) {
        const double K = m * (m - 1.0) * (m - 2.0) / 6;
        h += K * per_triangle * std::exp((K - 1) * left) / M;
    }
    return h * WORTH_NS < cost_ns;
}

StarSearch::StarSearch(int most_stars, const Patterns &sky, Arena &arena)
    : stars_(image_stars(most_stars, arena)),
      order_(most_stars, arena),
      best_(verification(most_stars, arena)),
      verified_(verification(most_stars, arena)) {
    const Pairs *pairs[LEVELS] = {&sky.bright_pairs, &sky.pairs};
    for (int level = 0; level < LEVELS; ++level) {
        const auto stars = static_cast<size_t>(pairs[level]->stars);
        latest_[level] = arena.take<int32_t>(stars);
        std::fill(latest_[level], latest_[level] + stars, -1);
    }
}

size_t StarSearch::bytes(int most_stars, const Patterns &sky) {
    const auto most = static_cast<size_t>(most_stars);
    return TriangleOrder::bytes(most_stars) + 3 * Arena::padded<int32_t>(most) +
           3 * Arena::padded<double>(most) + Arena::padded<Vector3>(most) +
           Arena::padded<Point>(most) +
           Arena::padded<int32_t>(static_cast<size_t>(sky.bright_pairs.stars)) +
           Arena::padded<int32_t>(static_cast<size_t>(sky.pairs.stars));
}

void StarSearch::begin(double most_work_s) {
    level_ = looked_up_ = other_matched_ = 0;
    level_begun_ = looking_up_ = false;
    tested_ = 0.0;
    work_ = {0.0, 0.0, 1e9 * most_work_s};
    best_.false_alarm = 1.0;
    best_.found.focal_ratio = 1.0;
    best_.found.R = identity<3>();
    std::fill(best_.found.star, best_.found.star + stars_.count, -1);
    std::fill(best_.found.residual, best_.found.residual + stars_.count, NAN);
}

Outcome StarSearch::proceed(const Verifier &verifier, const BrightLevel &bright,
                            double false_alarm_max, double slice_s, const volatile uint32_t *stop,
                            Arena &work) {
    if (stars_.count < LEAST_STARS) {
        return Outcome::TOO_FEW;
    }
    work_.pause_ns = work_.done_ns + 1e9 * slice_s;
    while (level_ < LEVELS) {
        if (!looking_up_ && !next_triangle(verifier, bright, false_alarm_max)) {
            ++level_;
            level_begun_ = false;
            continue;
        }
        looking_up_ = true;
        // In parts, so that the caller can stop it.
        Work part = work_;
        part.pause_ns = std::fmin(work_.pause_ns, work_.done_ns + STOP_PERIOD_NS);
        const bool done = triangle_.proceed(verifier, pairs(verifier), part, tested_);
        work_.done_ns = part.done_ns;
        if (done) {
            looking_up_ = false;
            ++looked_up_;
            const Outcome outcome = verify_all(verifier, false_alarm_max, work);
            if (outcome != Outcome::SEARCHING) {
                return outcome;
            }
            work_.done_ns +=
                cost_ns_ + PREDICTION_COST_NS * stars_.count +
                triangle_.count() * (TRIANGLE_COST_NS + VERIFICATION_COST_NS * stars_.count);
            if (work_.is_over()) {
                return Outcome::MOST_WORK;
            }
        }
        if (work_.is_paused() || (stop != nullptr && *stop != 0)) {
            return Outcome::SEARCHING;
        }
    }
    return Outcome::EXHAUSTED;
}

/// Begin to look up the next triangle of the level; false where more of them are of no use.
bool StarSearch::next_triangle(const Verifier &verifier, const BrightLevel &bright,
                               double false_alarm_max) {
    if (!level_begun_) {
        level_begun_ = true;
        looked_up_ = 0;
        order_.begin(level_ == 0 ? std::min(bright.image_stars, stars_.count) : stars_.count);
    }
    if (level_ == 0 && looked_up_ == bright.triangles) {
        return false;
    }
    if (looked_up_ % LOOK_PERIOD == LOOK_PERIOD - 1 &&
        is_searched(verifier, stars_.median_sigma, order_.count(), looked_up_,
                    work_.done_ns / looked_up_, counted(), false_alarm_max)) {
        return false;
    }
    int32_t base[3];
    cost_ns_ =
        order_.next(pairs(verifier), stars_, verifier.side_sigmas, verifier.scale_error, base);
    if (cost_ns_ < 0) {
        return false;
    }
    triangle_.begin(verifier, stars_, base, latest_[level_]);
    return true;
}

/// Verify the candidates of a triangle: two accepted ones of different attitudes are ambiguous.
Outcome StarSearch::verify_all(const Verifier &verifier, double false_alarm_max, Arena &work) {
    int accepted = 0;
    for (int row = 0; row < triangle_.count(); ++row) {
        verify(verifier, stars_, triangle_.base(), triangle_.candidate(row), 3, counted(),
               verified_, work);
        const bool better = verified_.false_alarm < best_.false_alarm;
        if (verified_.false_alarm <= false_alarm_max &&
            (accepted == 0 || !same_attitude(verified_.found, best_.found, stars_.count))) {
            ++accepted;
            other_matched_ = count_matched((better ? best_ : verified_).found, stars_.count);
        }
        if (better) {
            std::swap(verified_, best_);
        }
    }
    return accepted == 0   ? Outcome::SEARCHING
           : accepted == 1 ? Outcome::IDENTIFIED
                           : Outcome::AMBIGUOUS;
}

}  // namespace st

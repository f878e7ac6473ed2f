// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/lens_mismatch.h"

#include <algorithm>
#include <cmath>

#include "identify/false_alarm.h"
#include "sky/near.h"

namespace st {
namespace {

constexpr double NEAR_MISS_RADII = 8.0;
// So improbable a number of near misses is not due to chance.
constexpr double NEAR_MISS_PROBABILITY = 1e-3;
// e: blends without a mark, at most as many as have one: 4 % at 42 arcsec a pixel and V 6.5.
constexpr double BLENDED_SHARE = 0.05;
// w: less than that of a focal length 1 % off, 0.7, for a cluster that matches as a whole.
constexpr double MISSED_SHARE = 0.5;

/// Unmatched image stars, and those of them near a single unmatched catalogue star.
struct NearMisses {
    int unmatched, near;
};

NearMisses near_misses(const Patterns &sky, bool equidistant, const ImageStars &stars,
                       const StarMatch &found, double radius) {
    NearMisses misses{0, 0};
    for (int i = 0; i < stars.count; ++i) {
        if (found.star[i] >= 0) {
            continue;
        }
        ++misses.unmatched;
        const int32_t star =
            nearest(sky.cells, sky.direction, icrf_direction(equidistant, found, stars.seen[i]),
                    NEAR_MISS_RADII * radius)
                .star;
        misses.near +=
            star >= 0 && sky.blended[star] == 0 &&
            std::find(found.star, found.star + stars.count, star) == found.star + stars.count;
    }
    return misses;
}

}  // namespace

bool lens_mismatch(const Patterns &sky, bool equidistant, const ImageStars &stars,
                   const StarMatch &found, double radius, double sigma, int m, double p) {
    const auto [n, k] = near_misses(sky, equidistant, stars, found, radius);
    const double p_miss = std::fmin(p * (NEAR_MISS_RADII * NEAR_MISS_RADII - 1), 1.0);
    if (binomial_tail(k, n, p_miss) >= NEAR_MISS_PROBABILITY) {
        return false;
    }
    double log_ratio = m * std::log((1 - BLENDED_SHARE) / (1 - MISSED_SHARE) * radius * radius /
                                    (2 * sigma * sigma));
    for (int i = 0; i < stars.count; ++i) {
        if (found.residual[i] >= 0) {
            log_ratio -= found.residual[i] * found.residual[i] / (2 * sigma * sigma);
        }
    }
    const double chance = n * p_miss;
    log_ratio +=
        k * std::log((BLENDED_SHARE * (m + k) + chance) / (MISSED_SHARE * (m + k) + chance));
    return log_ratio < 0;
}

}  // namespace st

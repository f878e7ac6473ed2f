// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/image_stars.h"

#include <cmath>

#include "maths/sorting.h"

namespace st {
namespace {

// Two centroids closer than this are one star that was found twice.
constexpr double DUPLICATE_PX = 1.5;

/// Whether a centroid is near one of the chosen ones.
bool is_duplicate(const st_centroid *centroids, const st_centroid &one, const int32_t *chosen,
                  int count) {
    for (int j = 0; j < count; ++j) {
        const double du = centroids[chosen[j]].u_px - one.u_px;
        const double dv = centroids[chosen[j]].v_px - one.v_px;
        if (du * du + dv * dv < DUPLICATE_PX * DUPLICATE_PX) {
            return true;
        }
    }
    return false;
}

}  // namespace

ImageStars image_stars(int most, Arena &arena) {
    const auto capacity = static_cast<size_t>(most);
    return {0,
            arena.take<int32_t>(capacity),
            arena.take<Vector3>(capacity),
            arena.take<Point>(capacity),
            arena.take<double>(capacity),
            0.0};
}

void usable_stars(const Lens &lens, const st_centroid *centroids, const int32_t *order, int count,
                  int max_stars, double sigma_floor_px, ImageStars &stars) {
    stars.count = 0;
    for (int k = 0; k < count && stars.count < max_stars; ++k) {
        const st_centroid &one = centroids[order[k]];
        const Point pixel{one.u_px, one.v_px};
        // NaN is in no range.
        if (!shows(lens, pixel) || !(one.sigma_px > 0 && one.sigma_px < INFINITY) ||
            is_duplicate(centroids, one, stars.index, stars.count)) {
            continue;
        }
        const Point plane = undistorted(lens, pixel);
        // A fisheye has no stars outside its circle.
        if (std::isnan(plane.x)) {
            continue;
        }
        const int row = stars.count++;
        stars.index[row] = order[k];
        stars.direction[row] = ray(lens.equidistant, plane);
        stars.sigma[row] = std::sqrt(
            (one.sigma_px * one.sigma_px + sigma_floor_px * sigma_floor_px) / (lens.fx * lens.fy));
    }
}

void brightest_stars(const Lens &lens, const st_centroid *centroids, int count, int max_stars,
                     double sigma_floor_px, ImageStars &stars, Arena &work) {
    const Arena::Scope scope(work);
    auto *order = work.take<int32_t>(static_cast<size_t>(count));
    auto *scratch = work.take<int32_t>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        order[i] = i;
    }
    // Stars of an unknown flux last.
    sort(order, count, scratch, [&](int32_t a, int32_t b) {
        const double flux_a = centroids[a].flux_dn, flux_b = centroids[b].flux_dn;
        return flux_a > flux_b || (std::isnan(flux_b) && !std::isnan(flux_a));
    });
    usable_stars(lens, centroids, order, count, max_stars, sigma_floor_px, stars);
    complete(lens.equidistant, stars, work);
}

void complete(bool equidistant, ImageStars &stars, Arena &work) {
    const Arena::Scope scope(work);
    auto *sigma = work.take<double>(static_cast<size_t>(stars.count));
    for (int i = 0; i < stars.count; ++i) {
        stars.seen[i] = plane_point(equidistant, stars.direction[i]);
        sigma[i] = stars.sigma[i];
    }
    stars.median_sigma = stars.count > 0 ? ranked(sigma, stars.count, stars.count / 2) : 0.0;
}

}  // namespace st

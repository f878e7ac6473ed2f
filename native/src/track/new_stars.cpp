// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/new_stars.h"

#include <algorithm>
#include <cmath>

#include "maths/sorting.h"

namespace st {

double zero_point(const TrackList &bank, const SkyFile &file, Arena &work) {
    const Arena::Scope scope(work);
    auto *measured = work.take<double>(static_cast<size_t>(bank.count));
    int count = 0;
    for (const Track &track : bank) {
        if (track.is_detected()) {
            if (!(track.flux_dn > 0)) {
                return NAN;
            }
            measured[count++] = file.magnitude[track.star] + 2.5 * std::log10(track.flux_dn);
        }
    }
    return count == 0 ? NAN : median(measured, count);
}

size_t match_new_stars_bytes(int stars, int centroids) {
    const auto n = static_cast<size_t>(stars), m = static_cast<size_t>(centroids);
    return Arena::padded<Point>(m) + Arena::padded<double>(m) + Arena::padded<int>(m) +
           Arena::padded<StarInView>(n) + Arena::padded<bool>(n) + 2 * Arena::padded<int>(n);
}

void match_new_stars(const ApparentSky &sky, const Quaternion &attitude, const Matrix3 &covariance,
                     const Lens &lens, const FreeCentroid *free, int count, double zero_point,
                     double magnitude_tolerance, StarsInView &view, List<NewStar> &found,
                     Arena &work) {
    const Arena::Scope scope(work);
    const auto n = static_cast<size_t>(count);
    auto *uv = work.take<Point>(n);
    auto *magnitude = work.take<double>(n);
    auto *of_centroid = work.take<int>(n);
    for (int j = 0; j < count; ++j) {
        uv[j] = free[j].uv;
        magnitude[j] = free[j].flux_dn > 0 ? zero_point - 2.5 * std::log10(free[j].flux_dn) : NAN;
        of_centroid[j] = 0;
    }
    auto seen = work.list<StarInView>(static_cast<size_t>(view.near.capacity));
    stars_beside(sky, attitude, uv, count, MAX_DISTANCE_PX, view, seen, work);
    // Of each star how many centroids agree with it, and the last of them.
    auto *of_star = work.take<int>(static_cast<size_t>(seen.count));
    auto *partner = work.take<int>(static_cast<size_t>(seen.count));
    const SkyFile &file = *sky.file;
    for (int i = 0; i < seen.count; ++i) {
        const StarInView &star = seen[i];
        const double tolerance =
            magnitude_tolerance +
            VARIABLE_SIGMAS * static_cast<double>(file.variation_mag[star.star]);
        double predicted_variance = NAN;
        of_star[i] = 0;
        for (int j = 0; j < count; ++j) {
            const double du = uv[j].x - star.uv.x, dv = uv[j].y - star.uv.y;
            const double square = du * du + dv * dv;
            // Written so that NaN never agrees.
            if (!(square < MAX_DISTANCE_PX * MAX_DISTANCE_PX &&
                  std::fabs(magnitude[j] - file.magnitude[star.star]) <= tolerance)) {
                continue;
            }
            if (std::isnan(predicted_variance)) {
                const Covariance2 P = pixel_covariance(flow_of(lens, star.sensor), covariance);
                predicted_variance = (P.uu + P.vv) / 2;
            }
            const double sigma_px = free[j].sigma_px;
            if (square <=
                NEW_STAR_SIGMA * NEW_STAR_SIGMA * (sigma_px * sigma_px + predicted_variance)) {
                ++of_star[i];
                partner[i] = j;
                ++of_centroid[j];
            }
        }
    }
    for (int i = 0; i < seen.count; ++i) {
        if (of_star[i] == 1 && of_centroid[partner[i]] == 1 && !is_crowded(sky, seen[i].star)) {
            found.add({seen[i].star, free[partner[i]].centroid});
        }
    }
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/highest_peaks.h"

#include <cmath>

#include "centroid/background.h"
#include "centroid/detection.h"
#include "centroid/smoothing.h"
#include "centroid/spots.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr double FILTER_SIGMA_PX = 1.0;
// What is listed at all: in an image of noise, hundreds of times as many as are kept. One pixel of
// one level is 0.16 levels high after the filter.
constexpr Threshold LOWEST{1.5, 0.1};
// Error of a top that has no noise, of a lens whose stars are not Gaussian.
constexpr double LEAST_ERROR_PX = 0.1;

/// Noise of rounding to whole levels after the filter, 1 sigma.
double rounding_noise(const Kernel &kernel) {
    return kernel.noise_gain / std::sqrt(12.0);
}

/// Return a peak as a star as wide as the filter: the matched filter gives it the height
/// F / (4 pi sigma^2) and the error sqrt(2) sigma / snr.
st_centroid star_of(const Peak &peak, double noise) {
    st_centroid star{};
    star.u_px = peak.u + peak.top_u;
    star.v_px = peak.v + peak.top_v;
    star.flux_dn = 4 * M_PI * FILTER_SIGMA_PX * FILTER_SIGMA_PX * peak.height;
    star.snr = peak.height / noise;
    star.sigma_px = std::hypot(std::sqrt(2.0) * FILTER_SIGMA_PX / star.snr, LEAST_ERROR_PX);
    star.cov_uu_px2 = star.cov_vv_px2 = star.sigma_px * star.sigma_px;
    return star;
}

}  // namespace

void find_highest_peaks(const Image &image, List<st_centroid> &stars, Arena &arena) {
    const Arena::Scope scope(arena);
    const Kernel kernel = gaussian_kernel(FILTER_SIGMA_PX);
    const size_t tiles = most_tiles(image.width, image.height);
    const Mesh mesh = measure_background(image, kernel, arena.take<double>(tiles),
                                         arena.take<double>(tiles), arena);
    const Search search =
        find_peaks(image, kernel, mesh, LOWEST, most_peaks(image.width, image.height), arena);
    const double least_noise = rounding_noise(kernel);
    const auto count = static_cast<size_t>(search.peaks.count);
    auto *found = arena.take<st_centroid>(count);
    for (int i = 0; i < search.peaks.count; ++i) {
        found[i] = star_of(search.peaks[i], std::fmax(search.peaks[i].noise, least_noise));
    }
    sort(found, search.peaks.count, arena.take<st_centroid>(count),
         [](const st_centroid &a, const st_centroid &b) { return a.snr > b.snr; });
    for (int i = 0; i < search.peaks.count && i < HIGHEST_PEAKS; ++i) {
        stars.add(found[i]);
    }
    sort_by_flux(stars, arena);
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/psf_sigma.h"

#include <cmath>

#include "centroid/misfit.h"
#include "centroid/point_stars.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr int BATCH = 10;  // peaks fitted at a time, brightest first
constexpr int MOST_BATCHES = 6, MOST_SPOTS = BATCH * MOST_BATCHES;
constexpr int ENOUGH_STARS = 3;
constexpr double STAR_SHARE = 0.5;   // of the spots, whose median is the PSF sigma
constexpr double MOST_ERROR = 0.25;  // relative, of the PSF sigma of a star that counts
// Of a narrower star in the middle of its pixel no other pixel has a share.
constexpr double NARROWEST_PX = 0.3;
constexpr int SIGMA_ITERATIONS = 4;
constexpr double NARROW_QUANTILE = 0.1;

/// Sigmas in the order of the peaks.
struct Sigmas {
    double sigma[MOST_SPOTS];
    int count = 0;

    void add(double one) { sigma[count++] = one; }

    /// Return the median of the first ones; an even number has that of the middle ones.
    double median_of(int first) const {
        double values[MOST_SPOTS];
        const int size = first < count ? first : count;
        for (int k = 0; k < size; ++k) {
            values[k] = sigma[k];
        }
        return median(values, size);
    }

    /// Return a quantile, linear between the values.
    double quantile(double share) const {
        double ordered[MOST_SPOTS + 1];
        for (int k = 0; k < count; ++k) {
            insert_sorted(ordered, k, sigma[k]);
        }
        const double place = share * (count - 1);
        const int below = static_cast<int>(place);
        const double part = place - below;
        return below + 1 < count ? ordered[below] + part * (ordered[below + 1] - ordered[below])
                                 : ordered[below];
    }
};

/// Add the sigmas of count peaks that may be unsaturated stars to all, and those that Gaussians
/// explain to stars.
void add_sigmas(const Frame &frame, const Peak *peaks, int count, Sigmas &all, Sigmas &stars,
                Arena &arena) {
    FreeStar fitted[BATCH];
    const NoiseModel noise =
        initial_noise_model(frame.background_dn(), frame.noise_dn() * frame.noise_dn());
    const int fits = fit_free_sigma(frame, peaks, count, noise, frame.kernel.sigma_px,
                                    SIGMA_ITERATIONS, fitted, arena);
    for (int i = 0; i < fits; ++i) {
        const Fit<5> &fit = fitted[i].fit;
        const double sigma = fit.star[SIGMA], variance = fit.covariance[SIGMA][SIGMA];
        // That of a fit that fails may be negative.
        if (!(variance >= 0 && std::sqrt(variance) < MOST_ERROR * sigma && fitted[i].is_star)) {
            continue;
        }
        all.add(sigma);
        if (sigma > NARROWEST_PX &&
            misfit(fit.chi2, fit.dof, fit.star[FLUX], fit.covariance[FLUX][FLUX]) < MOST_MISFIT) {
            stars.add(sigma);
        }
    }
}

}  // namespace

PsfSigma measure_psf_sigma(const Frame &frame, bool narrow, Arena &arena) {
    const List<Peak> &peaks = frame.search.peaks;
    Sigmas all, stars;
    for (int first = 0; first < peaks.count && first < MOST_SPOTS; first += BATCH) {
        const int count = peaks.count - first < BATCH ? peaks.count - first : BATCH;
        add_sigmas(frame, peaks.item + first, count, all, stars, arena);
        const double enough = STAR_SHARE * all.count;
        if (!narrow && stars.count >= ENOUGH_STARS && stars.count >= enough) {
            return {stars.median_of(MOST_SPOTS), true};
        }
    }
    if (stars.count >= ENOUGH_STARS) {
        return {narrow ? stars.quantile(NARROW_QUANTILE) : stars.median_of(MOST_SPOTS), false};
    }
    return {all.count > 0 ? all.median_of(BATCH) : frame.kernel.sigma_px, false};
}

size_t psf_sigma_bytes() {
    return points_bytes(BATCH);
}

}  // namespace st

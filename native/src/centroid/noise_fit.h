// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Gain and model error of the noise, out of the residuals of all stars.

#pragma once

#include "centroid/gaussian_fit.h"
#include "centroid/noise.h"
#include "maths/arena.h"

namespace st {

/// Numbers of pixels that are kept: of 600 stars of sigma 1 px.
constexpr int MOST_NOISE_PIXELS = 1 << 16;

/// The pixels of fitted stars, of as many as there is memory for: the first ones, which are the
/// brightest.
class NoiseFit {
public:
    /// Memory for the windows of count stars, of area_px pixels each.
    NoiseFit(int count, int area_px, Arena &arena);

    /// Keep the pixels of star number i, whose window and model are in work.
    void add(int i, const Fit<4> &fit, const FitWork &work);

    /// Return gain and model error by the pixels of stars for which chosen(i) holds, by iterated
    /// least squares.
    ///
    /// The squares of the residuals r, divided by 1 - h for the leverage h of their pixel, have the
    /// mean background + gain flux + (model_error flux)^2. The initial gain counts as some pixels,
    /// so that one or two faint stars change nothing.
    template <class Chosen>
    NoiseModel refined(NoiseModel noise, Chosen chosen) const {
        const double prior = noise.gain_dn;
        for (int k = 0; k < NOISE_ITERATIONS; ++k) {
            Sums sums = prior_sums(prior);
            for (int one = 0; one < stars_; ++one) {
                if (chosen(star_[one].number)) {
                    add_sums(one, noise, sums);
                }
            }
            noise = solved(sums);
        }
        return noise;
    }

private:
    static constexpr int NOISE_ITERATIONS = 3;

    struct KeptStar {
        int number;
        float background;
    };

    /// Normal equations [a b; b c] [gain, model_error^2] = [p q].
    struct Sums {
        double a, b, c, p, q;
    };

    static Sums prior_sums(double gain_dn);
    static NoiseModel solved(const Sums &sums);
    void add_sums(int one, const NoiseModel &noise, Sums &sums) const;

    int area_, capacity_, stars_ = 0;
    KeptStar *star_;
    float *square_, *flux_;  // r^2 / (1 - h), and the flux of the model, 0 where not used
};

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Noise of the pixels of a star: background, photons and the error of the star's model.

#pragma once

#include <cmath>

namespace st {

/// Variance of a pixel: background + gain_dn * flux + (model_error * flux)^2. gain_dn is the DN of
/// one photo-electron (Poisson noise), model_error the relative error of a Gaussian as the point
/// spread function of a real lens.
struct NoiseModel {
    double gain_dn;
    double model_error = 0.0;
};

/// Return the variance in DN^2 of a pixel with this flux in DN and background variance.
inline double pixel_variance(const NoiseModel &noise, double background, double flux) {
    flux = flux > 0.0 ? flux : 0.0;
    return background + flux * (noise.gain_dn + noise.model_error * noise.model_error * flux);
}

/// Return the initial model: the background is photons, as in a camera without offset.
inline NoiseModel initial_noise_model(double level_dn, double variance) {
    const double least = 3 * std::sqrt(variance);
    return {variance / (level_dn > least ? level_dn : least)};
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Gaussian point spread function, integrated over the pixels.
//
// A star of flux F at (u, v) and of width sigma puts the flux F a(x) d(y) into pixel (x, y):
//
//     a(x) = Phi((x + 1/2 - u) / sigma) - Phi((x - 1/2 - u) / sigma),  d(y) likewise with v
//
// Phi(z) = (1 + erf(z / sqrt(2))) / 2 is the normal distribution and phi its density.

#pragma once

#include "maths/matrix.h"

namespace st {

enum { U, V, FLUX, LEVEL, SIGMA };  // parameters of a star: px, px, DN, DN above the mesh, px
using Star = Vector<5>;

constexpr int MOST_COLUMNS = 64;  // of a window, or of what else a star is compared with

/// a, da/du and da/dsigma of pixels side by side.
template <class Number>
struct Profile {
    alignas(16) Number share[MOST_COLUMNS], d_centre[MOST_COLUMNS], d_sigma[MOST_COLUMNS];
};

/// Fill the profile of count pixels from `first` on, along one axis; count is 0 to MOST_COLUMNS.
///
/// With z = (x - u) / sigma at the lower and the upper edge of a pixel:
///
///     da/du = (phi(z_lower) - phi(z_upper)) / sigma
///     da/dsigma = (z_lower phi(z_lower) - z_upper phi(z_upper)) / sigma
///
/// Phi and phi are Taylor series in t = z - z0 around the nearest node z0 of a table, good to 1e-9
/// and 4e-8, which takes a tenth of the time of erf() and exp():
///
///     Phi(z) = Phi(z0) + phi(z0) t (1 - z0 t / 2 + (z0^2 - 1) t^2 / 6)
///     phi(z) = phi(z0) (1 - z0 t + (z0^2 - 1) t^2 / 2 - z0 (z0^2 - 3) t^3 / 6)
template <class Number>
void profile(double centre, double sigma, int first, int count, Profile<Number> &of);

}  // namespace st

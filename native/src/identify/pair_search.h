// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Catalogue pairs that may be one side of an image triangle: k-vector range and star lists.
//
// Image stars i and j are an angle theta apart, measured with the errors sigma_i and sigma_j. The
// noise gate is
//
//     rho = n sqrt(sigma_i^2 + sigma_j^2),    n = 0.5 tolerance_sigmas.
//
// Stars that verify a candidate are searched within all of tolerance_sigmas. The sides of a triangle
// have fewer, since the join below grows as n^2 and the triangles that fit by chance as n^3: of
// errors as given 78 % of the true triangles are within 1.75 sigma, and a field has others.
//
// The focal length is known to a share e, so that the true separation is s theta with
// 1 - e <= s <= 1 + e. That range is cut into B bands of centre s_0 and half width h. In a band the
// catalogue pairs of separation d with
//
//     |d - s_0 theta| <= rho + h theta
//
// may be the side. They are one range of the pairs sorted by d, found by the k-vector (Mortari and
// Neta 2000). Of N stars spread evenly over the sky
//
//     n_ij = N^2 / 2 sin theta (rho + e theta)
//
// pairs are in the ranges of all bands by chance. Sides ab and ac are joined in their common star:
// the pairs of ab are listed by star, like the identifier array of Yuan, Zhang, Shi (2017), and each
// pair of ac finds those of its two stars. By chance the join has 4 n_ab n_ac / (N B) members.

#pragma once

#include <cmath>

#include "identify/image_stars.h"
#include "identify/patterns.h"

namespace st {

/// Angle theta and noise gate rho in rad of an image side, and theta / rho^2.
struct Side {
    double theta, rho, weight;
};

/// Centre and half width of a band of focal lengths; low <= s < high belong to it.
struct ScaleBand {
    double centre, half, low, high;
};

/// Entries of the pairs that may be a side: entry e stands for a star member[e] with the partner
/// member[e ^ 1].
struct Entries {
    int64_t first, end;
};

inline Side image_side(const ImageStars &stars, double side_sigmas, int i, int j) {
    double square = 0.0;
    for (int k = 0; k < 3; ++k) {
        const double d = stars.direction[i][k] - stars.direction[j][k];
        square += d * d;
    }
    const double half = std::sqrt(square) / 2, theta = 2 * std::asin(half < 1 ? half : 1.0);
    const double rho =
        side_sigmas * std::sqrt(stars.sigma[i] * stars.sigma[i] + stars.sigma[j] * stars.sigma[j]);
    return {theta, rho, theta / (rho * rho)};
}

/// n of a side over tolerance_sigmas.
constexpr double SIDE_SIGMAS = 0.5;

/// Return B, the number of bands.
inline int band_count(double scale_error) {
    constexpr double BAND = 0.005;  // to either side
    const int bands = static_cast<int>(std::ceil(scale_error / BAND));
    return bands > 1 ? bands : 1;
}

/// Return one of count bands; the outer ones are open, since the noise gates bound them.
inline ScaleBand scale_band(int band, int count, double scale_error) {
    const double half = scale_error / count, centre = 1 - scale_error + (2 * band + 1) * half;
    return {centre, half, band > 0 ? centre - half : 0.0,
            band < count - 1 ? centre + half : INFINITY};
}

/// Return n_ij, 0 where the separations of the pairs do not reach.
inline double expected_pairs(const Pairs &pairs, const Side &side, double scale_error) {
    const double reach = side.rho + scale_error * side.theta;
    if (pairs.pairs == 0 || side.theta + reach < pairs.separation_rad[0] ||
        side.theta - reach > pairs.separation_rad[pairs.pairs - 1]) {
        return 0.0;
    }
    const double stars = pairs.stars;
    return stars * stars / 4 * std::sin(side.theta) * 2 * reach;
}

inline Entries entries_of(const Pairs &pairs, const Side &side, const ScaleBand &band) {
    const double middle = band.centre * side.theta, slack = band.half * side.theta;
    const PairRange range =
        pairs_between(pairs, middle - side.rho - slack, middle + side.rho + slack);
    return {int64_t{2} * range.first, int64_t{2} * range.end};
}

}  // namespace st

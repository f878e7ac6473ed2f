// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The false-alarm probability: how likely a wrong candidate agrees as well as this one.
//
// Four tests, each a probability under the hypothesis that the candidate is wrong:
//
// Number of matches. Each of the n image stars beyond the B of the pattern falls within the radius r
// of one of the S catalogue stars of the field with p = S pi r^2 / A, A the area of the image. m
// matches or more of n have the binomial tail
//
//     P_1 = sum_{k=m}^n C(n, k) p^k (1 - p)^(n - k).
//
// Stars of a cluster are not independent: the Pleiades, shifted or turned, put several stars on
// others at once. So the stars of one small cell of the image count as one.
//
// Density of the field. A wrong candidate points anywhere on the sky; P_2 is the share of random
// fields that hold S catalogue stars or fewer.
//
// Order of brightness. Were the candidate wrong, any order of the catalogue stars would be as likely
// as that of their image stars. P_3 is the share of permutations with no more inversions (Kendall
// 1938). No photometry is needed but the order.
//
// Residuals. By chance the squared residuals d_i^2 / r^2 are uniform in 0 .. 1. The probability that
// m such numbers have a sum below x is at most P_4 = x^m / m!.
//
// The product P of these is combined as Fisher (1925) does it, and T candidates were tested:
//
//     P_FA = min(1, T P (1 + L + L^2 / 2 + L^3 / 6)),    L = -ln P.

#pragma once

#include <cstdint>

#include "identify/image_stars.h"

namespace st {

/// Cells along one side of a square image: 3/4 of a degree in a field of 12.
constexpr int CELLS_ACROSS = 16;

/// Mark the brightest matched star of each cell of an image of an area in rad^2, across of them along
/// the side of a square one; return how many cells hold stars. star is -1 for image stars without a
/// match.
int occupied_cells(const ImageStars &stars, const int32_t *star, double area, int across,
                   bool *brightest, Arena &work);

/// Return P_1, the probability of m or more successes of n.
double binomial_tail(int m, int n, double p);

/// Return P_3 of the catalogue stars of the chosen ones among count image stars; both image stars
/// and catalogue stars go from bright to faint.
double order_probability(const int32_t *star, const bool *chosen, int count);

/// Return P_4 of the residuals of count image stars, NaN where there is no match. The base stars of
/// the pattern took part in the fit: they add to the sum x but not to m.
double residual_probability(const double *residual, int count, double radius, int base);

/// Return the probability that four uniform numbers have a product of P or less.
double fisher_combined(double product);

/// Return the least number of true stars among n that has a false-alarm probability of at most
/// most, n + 1 if there is none.
///
/// p and the base as in P_1, share is P_2, tested T; the stars are in order, and their residuals
/// those of a normal distribution of sigma = r / tolerance_sigmas.
int least_matches(int n, double p, double share, int base, double tolerance_sigmas, double tested,
                  double most);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Test for a lens that differs from its model.
//
// With a wrong focal length or distortion a few stars match, and around them the others lie near
// catalogue stars, more often than by chance, but not at them. With p the probability of a match
// within the radius r, a random star has a near miss within R = 8 r with the probability
// p_R = p (R^2 / r^2 - 1); k near misses of n unmatched stars are tested against the binomial tail.
//
// Near misses have another cause where the lens is right: two close stars may be resolved, joined,
// or the fainter one missed, otherwise than the catalogue assumes. A near miss of an entry that the
// catalogue marks as blended is therefore not counted. The others are weighed by the likelihoods of
// the whole field. m matches beyond those of the pattern have residuals d_i of the standard
// deviation sigma.
//
// H_0, the lens is right: a share e of the stars is blended and misses its entry, the others have
// Gaussian residuals. H_1, the lens is wrong: a share w misses, the others match where the wrong
// positions happen to be less than r off, with residuals uniform in the disc. In both cases n p_R
// near misses are chance. With s = m + k
//
//     ln (L_0 / L_1) = m ln ((1 - e) / (1 - w) r^2 / (2 sigma^2)) - sum_i d_i^2 / (2 sigma^2)
//                      + k ln ((e s + n p_R) / (w s + n p_R)).
//
// The lens is rejected when the near misses are not by chance and the ratio is below one.

#pragma once

#include "identify/association.h"

namespace st {

/// Whether the near misses of a field are due to its lens; m counts the matches that are evidence,
/// p is the probability that a star falls within the radius of a catalogue star by chance.
bool lens_mismatch(const Patterns &sky, bool equidistant, const ImageStars &stars,
                   const StarMatch &found, double radius, double sigma, int m, double p);

}  // namespace st

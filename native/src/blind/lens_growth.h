// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// An unknown lens grown from four stars outwards.
//
// An assumed lens is right only near the stars that led to it. Fit and matching alternate: the
// covariance P of the fitted parameters gives the pixel of each other catalogue star with the
// covariance C = H P H^T + s^2, H the derivatives of its pixel and s the error of the spots. A spot
// within the gate e^T C^-1 e < 9 is that star, unless the gate is so large that it holds a spot by
// chance. So the match spreads over the image as the lens becomes known.
//
// Were the four stars wrong, each of n other spots would be within r = 3 s of one of S stars of the
// image with p = S pi r^2 / A, A the area over which the spots are spread. m matches of n have the
// binomial tail P_1, their order of brightness P_3 of identify/false_alarm.h. The parameters of the
// fit are worth six stars, which do not count. Both are combined as Fisher does.

#pragma once

#include "blind/lens_fit.h"
#include "maths/arena.h"

namespace st {

/// Work memory for the spots of an image; star is that of each, -1 for none.
struct SpotWork {
    SpotWork(int spots, Arena &arena);

    bool is_whole() const { return chosen != nullptr; }

    double *square, *best;
    int32_t *before, *star;
    bool *chosen;
};

/// Set the star in whose gate each spot of an error per axis is, one to one, -1 for none; best has
/// room for the spots.
void gated_stars(const LensFit &fit, int parameters, double error_px, const SkyAndSpots &seen,
                 int32_t *star, double *best);

/// Grow a lens from the four spots that are stars of these numbers; return how probable it is that so
/// many spots are matched by chance.
double grow_lens(const LensPrior &prior, const SkyAndSpots &seen, const int32_t spot[4],
                 const int32_t four[4], LensFit &fit, const SpotWork &work);

}  // namespace st

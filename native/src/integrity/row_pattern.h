// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Whether all of an image shows one attitude, by its rows.
//
// A torn frame holds rows of the frame before, a rolling shutter whose line time is wrong shows each
// row at another time: part of the stars support one attitude, part another. Both leave a pattern:
// residuals along the motion of the stars that are a step, or grow, from row to row.
//
// The residuals r of the stars, whitened, are fitted with columns that are not a fault of the
// rows: a rotation, the focal length and a radial distortion. A column c = f g(v), f the velocity
// of a star and g(v) a step or a line, improves chi-square by (c' r)^2 / (c' c), both after those
// columns.

#pragma once

#include "integrity/detected_star.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

constexpr int STEPS = 12;  // rows at which a frame may be torn

/// Residuals r against columns c of patterns along the rows, first a line, then steps: c^T r, c^T c
/// and r^T r; step k + 1 is at edge[k], in heights of the image from its middle.
struct RowFit {
    double product[1 + STEPS], energy[1 + STEPS], edge[STEPS];
    double chi2;
};

/// Fit the residuals of at least 8 stars.
RowFit fit_rows(const Lens &lens, const DetectedStar *stars, int count, Arena &arena);

/// Bytes of work memory of so many stars.
size_t row_fit_bytes(int count);

/// What is remembered of the frames before: their slopes along the rows, which are the same in every
/// frame. All zero at the start.
struct RowPattern {
    double product, energy;  // of the line
    double excess;           // of chi-square
    int frames;
};

/// Return which pattern the residuals have: a torn frame, a wrong line time, or ST_NO_REASON.
st_reason find_pattern(const Lens &lens, const DetectedStar *stars, int count, RowPattern &memory,
                       Arena &arena);

}  // namespace st

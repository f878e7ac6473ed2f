// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Whitened residuals fitted with columns.
//
// A residual r of a star with covariance R = L L^T is whitened as L^-1 r. Columns that are not an
// error of the rows or of the lens (a rotation of all stars, a scale) are removed by an
// orthonormal basis Q: x <- x - Q Q^T x.

#pragma once

#include <cmath>

#include "maths/covariance2.h"

namespace st {

/// Return a^T b, four sums at a time.
inline double inner(const double *a, const double *b, int rows) {
    double sum[4] = {};
    int row = 0;
    for (; row + 4 <= rows; row += 4) {
        for (int k = 0; k < 4; ++k) {
            sum[k] += a[row + k] * b[row + k];
        }
    }
    for (; row < rows; ++row) {
        sum[0] += a[row] * b[row];
    }
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/// Set two rows of a column to L^-1 (x, y) with R = L L^T.
inline void whiten(const Covariance2 &R, double x, double y, double *rows) {
    const double a = std::sqrt(R.uu), b = R.uv / a;
    rows[0] = x / a;
    rows[1] = (y - b * x / a) / std::sqrt(R.vv - b * b);
}

/// Make the first columns orthonormal, or 0 if they depend on those before, and remove them from all:
/// columns lie one after the other, each of so many rows.
void remove_first(double *columns, int column_count, int rows, int first);

}  // namespace st

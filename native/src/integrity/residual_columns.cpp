// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/residual_columns.h"

namespace st {
namespace {

/// A column that keeps less of its length after the columns before is a sum of them.
constexpr double DEPENDENT = 1e-9;

}  // namespace

void remove_first(double *columns, int column_count, int rows, int first) {
    for (int k = 0; k < column_count; ++k) {
        double *column = columns + k * rows;
        const double before = std::sqrt(inner(column, column, rows));
        const int removed = k < first ? k : first;
        // Twice: once leaves rounding errors of what was removed.
        for (int pass = 0; pass < 2; ++pass) {
            for (int m = 0; m < removed; ++m) {
                const double *base = columns + m * rows;
                const double along = inner(base, column, rows);
                for (int row = 0; row < rows; ++row) {
                    column[row] -= along * base[row];
                }
            }
        }
        if (k < first) {
            const double left = std::sqrt(inner(column, column, rows));
            const double scale = left > DEPENDENT * before ? 1 / left : 0.0;
            for (int row = 0; row < rows; ++row) {
                column[row] *= scale;
            }
        }
    }
}

}  // namespace st

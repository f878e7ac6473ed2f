// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The stars near a direction, by the cells of the sky.

#pragma once

#include <cmath>
#include <cstdint>

#include "maths/matrix.h"
#include "sky/sky.h"

namespace st {

// Beyond what sums of squares and cell numbers round.
constexpr double CELL_ROUNDING = 1e-12;

struct CellRange {
    int32_t first, last;
};

/// Return a number as a whole one from 0 to most, 0 for NaN.
inline int32_t clipped(double number, int32_t most) {
    // fmin() and fmax() would be calls.
    return !(number > 0) ? 0 : number < most ? static_cast<int32_t>(number) : most;
}

/// Return the cells, along one axis, within a chord of a coordinate.
inline CellRange cells_about(const Cells &cells, double coordinate, double chord) {
    const double half = cells.cells / 2.0, reach = chord + CELL_ROUNDING;
    const int32_t last = cells.cells - 1;
    return {clipped((coordinate - reach + 1) * half, last),
            clipped((coordinate + reach + 1) * half, last)};
}

/// Call found(m) for the places of the stars of all cells within a chord of a unit vector, in the
/// order of the cells, until it is true; return whether it was.
template <class Found>
inline bool any_place_near(const Cells &cells, const Vector3 &centre, double chord, Found found) {
    const CellRange x = cells_about(cells, centre[0], chord);
    const CellRange y = cells_about(cells, centre[1], chord);
    const CellRange z = cells_about(cells, centre[2], chord);
    for (int32_t i = x.first; i <= x.last; ++i) {
        for (int32_t j = y.first; j <= y.last; ++j) {
            // The cells of a row are consecutive, and so are their stars.
            const int32_t row = (i * cells.cells + j) * cells.cells;
            const int32_t end = cells.start[row + z.last + 1];
            for (int32_t m = cells.start[row + z.first]; m < end; ++m) {
                if (found(m)) {
                    return true;
                }
            }
        }
    }
    return false;
}

/// Call found(star) for the stars of all cells within a chord of a unit vector, until it is true;
/// return whether it was.
template <class Found>
inline bool any_near(const Cells &cells, const Vector3 &centre, double chord, Found found) {
    return any_place_near(cells, centre, chord, [&](int32_t m) { return found(cells.member[m]); });
}

/// Call visit(star) for the stars of all cells within a chord of a unit vector.
template <class Visit>
inline void visit_near(const Cells &cells, const Vector3 &centre, double chord, Visit visit) {
    any_near(cells, centre, chord, [&visit](int32_t star) {
        visit(star);
        return false;
    });
}

/// Whether one of these directions, of any precision, is within a chord of a unit vector.
template <class Real>
inline bool has_near(const Cells &cells, const Real (*direction)[3], const Vector3 &centre,
                     double chord) {
    return any_near(cells, centre, chord, [&](int32_t star) {
        double square = 0.0;
        for (int k = 0; k < 3; ++k) {
            const double d = static_cast<double>(direction[star][k]) - centre[k];
            square += d * d;
        }
        return square <= chord * chord;
    });
}

/// The star nearest to a direction, -1 for none, and its squared chord, then infinite.
struct Nearest {
    int32_t star;
    double square;
};

/// Return the star of these directions that is nearest to a unit vector, within a chord.
inline Nearest nearest(const Cells &cells, const double (*direction)[3], const Vector3 &centre,
                       double chord) {
    const double limit = chord * chord;
    Nearest best{-1, INFINITY};
    visit_near(cells, centre, chord, [&](int32_t star) {
        const double *d = direction[star];
        const double dx = d[0] - centre[0], dy = d[1] - centre[1], dz = d[2] - centre[2];
        const double square = dx * dx + dy * dy + dz * dz;
        if (square <= limit && square < best.square) {
            best = {star, square};
        }
    });
    return best;
}

}  // namespace st

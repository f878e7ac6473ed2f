// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Triangles of stars by their shape, for fields of about one size.
//
// The sides of a triangle are d_0 >= d_1 >= d_2, its stars A, B, C those opposite. Its code is
// (d_2 / d_0, d_1 / d_0) and the sign of A . (B x C); codes are looked up in the cells of a grid, in
// each of which the triangles are in the order of d_0.

#pragma once

#include <cstdint>

#include "maths/rotation.h"
#include "startracker_ground.h"

namespace st {

/// Three stars, and the sides opposite to them in rad, the longest first.
struct Triangle {
    int32_t star[3];
    double side[3];

    /// d_2 / d_0 and d_1 / d_0.
    double shortest() const { return side[2] / side[0]; }
    double middle() const { return side[1] / side[0]; }

    /// Where d_1 + d_2 is hardly more than d_0, noise turns a triangle over.
    bool is_flat() const { return side[1] + side[2] < 1.02 * side[0]; }
};

/// Return the triangle of stars with these sides opposite to them.
inline Triangle triangle_of(const int32_t star[3], const double side[3]) {
    int order[3] = {0, 1, 2};
    const auto put_longer_first = [&](int i, int j) {
        if (side[order[i]] < side[order[j]]) {
            const int moved = order[i];
            order[i] = order[j];
            order[j] = moved;
        }
    };
    put_longer_first(0, 1);
    put_longer_first(1, 2);
    put_longer_first(0, 1);
    return {{star[order[0]], star[order[1]], star[order[2]]},
            {side[order[0]], side[order[1]], side[order[2]]}};
}

/// Whether A . (B x C) is negative.
inline bool is_turned(const Vector3 *direction, const int32_t star[3]) {
    return dot(direction[star[0]], cross(direction[star[1]], direction[star[2]])) < 0;
}

/// Return the cell along its axis of a ratio of sides.
inline int cell_along(double ratio) {
    const int cell = ratio > 0 ? static_cast<int>(ratio * ST_TRIANGLE_CELLS) : 0;
    return cell < ST_TRIANGLE_CELLS ? cell : ST_TRIANGLE_CELLS - 1;
}

/// Return the number of a cell from those along both axes and the sign.
inline int triangle_cell(int shortest, int middle, bool turned) {
    return ((turned ? ST_TRIANGLE_CELLS : 0) + shortest) * ST_TRIANGLE_CELLS + middle;
}

/// What triangles of the sky have: limits of the shortest and the longest side in rad.
struct TriangleLimits {
    double shortest_rad, least_longest_rad, longest_rad;
};

/// Call found(triangle, cell) for all triangles of stars of which each has the fainter partners
/// start[s] to start[s + 1].
template <class Found>
void visit_triangles(const Vector3 *direction, size_t stars, const int32_t *partner,
                     const int32_t *start, const TriangleLimits &limits, Found found) {
    for (size_t s = 0; s < stars; ++s) {
        const auto a = static_cast<int32_t>(s);
        for (int32_t m = start[a]; m < start[a + 1]; ++m) {
            const int32_t c = partner[m];
            const double ac = angle_between(direction[a], direction[c]);
            for (int32_t n = start[a]; n < m; ++n) {
                const int32_t b = partner[n];
                const double bc = angle_between(direction[b], direction[c]);
                if (bc > limits.longest_rad) {
                    continue;
                }
                const int32_t star[3] = {a, b, c};
                const double side[3] = {bc, ac, angle_between(direction[a], direction[b])};
                const Triangle one = triangle_of(star, side);
                if (one.side[0] >= limits.least_longest_rad &&
                    one.side[2] >= limits.shortest_rad && !one.is_flat()) {
                    found(one, triangle_cell(cell_along(one.shortest()), cell_along(one.middle()),
                                             is_turned(direction, one.star)));
                }
            }
        }
    }
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Quads of stars by their shape, whatever the scale of the image.
//
// Lang, Hogg, Mierle, Blanton, Roweis 2010, Astrometry.net. Four stars A, B, C, D, of which A and B
// are the farthest apart, are put on the stereographic plane that touches the sphere in the middle
// of A and B, turned and scaled so that A is (0, 0) and B is (1, 0). The code of the quad is
// (x_C, y_C, x_D, y_D), with x_C + x_D <= 1 and x_C <= x_D, which tell A from B and C from D.
// photographs/sky_quads.py makes the tables.

#pragma once

#include <cstdint>

#include "maths/matrix.h"
#include "sky/near.h"
#include "startracker_ground.h"

namespace st {

using Code = Vector<4>;

/// Quads of the sky that quads of an image may be: image stars (most, 4), rows of the table and
/// ratios of the sides.
struct QuadList {
    int32_t *star, *row;
    double *ratio;
    size_t most, count;
};

/// Set the code of stars A, B, C, D in the order that they have; false for stars without a code.
bool quad_code(const Vector3 *direction, const int32_t four[4], Code &code);

/// Add the quads of a table that have the code of one of count image quads (count, 4), within a
/// tolerance, in any order that noise allows. The side of the sky is low to high times that of the
/// image. Those with a star without a direction, NaN, are left out.
void match_quads(const st_quad_table &table, const Vector3 *direction, const int32_t *quads,
                 size_t count, double tolerance, double low, double high, QuadList &found);

/// Return the cell of a code.
int32_t quad_cell(const float code[4]);

/// Stars of a level in the order of their cells, star m the member[m]-th brightest: quads whose
/// longest side is the chord side to longest, of which C and D are two of the most_inner brightest
/// stars nearer to A and B than these are to each other. A star within the chord crowd of a brighter
/// one is in none.
struct QuadLevel {
    const Vector3 *direction;
    size_t stars;
    Cells cells;
    double side, longest, crowd;
    int most_inner;
};

/// Work memory for the neighbours of a star, as many as there are stars: near in the order of the
/// cells, by_rank with the brightest first.
struct QuadWork {
    int32_t *near;
    int64_t *by_rank;
    double *square;
    uint8_t *alone;
};

/// Codes (most, 4), stars (most, 4), sides in rad and their number.
struct QuadsMade {
    float *code, *side_rad;
    int32_t *star;
    size_t most, count;
};

/// Mark the stars that have no brighter one close to them.
void mark_alone(const QuadLevel &level, uint8_t *alone);

/// Add the quads of which star m is the brighter end, by their ranks; false where they would be too many.
bool make_quads(const QuadLevel &level, int32_t m, const QuadWork &work, QuadsMade &made);

}  // namespace st

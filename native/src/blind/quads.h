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

/// Add the quads of a table that have the code of four image stars, within a tolerance, in any order
/// that noise allows. The side of the sky is low to high times that of the image.
void match_quad(const st_quad_table &table, const Vector3 *direction, const int32_t stars[4],
                double tolerance, double low, double high, QuadList &found);

/// The quads of a level: stars A and B are long pairs, C and D of the most_inner brightest
/// neighbours of A, which ascend, that are nearer to A and B than these are to each other.
struct QuadBuild {
    const Vector3 *direction;
    const int32_t *neighbour, *start;  // those of star s are start[s] to start[s + 1]
    int most_inner;
};

/// Set code (4) and stars (4) of each quad of the pair A, B, and the side in rad; return how many.
int make_quads(const QuadBuild &level, int32_t a, int32_t b, float *code, int32_t *star,
               float *side_rad);

}  // namespace st

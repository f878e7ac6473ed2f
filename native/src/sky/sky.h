// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The sky file, written by `startracker sky` (startracker_ros/core/identify/sky_file.py): stars as
// a camera resolves them, cells of the sky, pairs of stars by separation. Read in place: pointers
// into the file, which st_check_sky has found sound.

#pragma once

#include <cstdint>

#include "maths/matrix.h"
#include "startracker.h"

namespace st {

/// Stars by the cells of a cube about the unit sphere: those of cell c are member[start[c]] to
/// member[start[c + 1] - 1], c = (i cells + j) cells + k.
struct Cells {
    int32_t cells;
    const int32_t *start, *member;
};

/// Pairs by separation, ascending: pair p has the stars member[2 p] and member[2 p + 1], rows of
/// star and direction. below[i] separations are under the line of the k-vector at step i;
/// previous[e] is the entry of member before e of the same star, -1 for none.
struct Pairs {
    int32_t stars, pairs;
    const int32_t *star;
    const double (*direction)[3];
    const double *separation_rad;
    const int32_t *below, *member, *previous;
    double first_rad, steps_per_rad;
};

/// Set the line of the k-vector, from the first separation to the last.
void set_steps(Pairs &pairs);

/// Stars brightest first; the first pattern_stars of them are those of patterns. A tracker that follows
/// none of the faint ones has a smaller number of stars, and all of the cells.
struct SkyFile {
    double epoch_year, crowd_rad, pixel_rad;
    double pattern_limit;        // magnitude
    double least_rad, most_rad;  // separations of the pairs
    int32_t stars, pattern_stars;
    const int32_t *hip;
    const double (*direction)[3];  // from the Earth at the epoch, without aberration
    const float (*motion)[3];      // rad a year
    const float *parallax_rad;
    const double *magnitude;
    const float *variation_mag;
    const uint8_t *crowded, *blended;
    Cells cells, pattern_cells;
    Pairs pairs, bright_pairs;
};

/// Find the sections of a sky file; false where one is missing or of another size. What is in
/// them is not looked at: that is for st_check_sky.
bool open_sky(const st_sky &file, SkyFile &sky, st_fault *fault);

/// Return the direction of a star so many years after the epoch of the file, from the Earth that
/// has moved by moved_au about the barycentre: uniform straight motion (ESA SP-1200, 1.5.5).
Vector3 direction_at(const SkyFile &sky, int32_t star, double years, const Vector3 &moved_au);

/// Put the stars within an angle of a unit vector into index, brightest first. Return how many
/// there are: beyond capacity the faintest are left out.
int32_t stars_in_cone(const SkyFile &sky, const Vector3 &axis, double radius_rad, int32_t *index,
                      int32_t capacity);

/// Return the pattern star nearest to a unit vector and the squared chord; -1 for none within one.
int32_t nearest_star(const SkyFile &sky, const Vector3 &direction, double chord, double &square);

/// A range of pairs, empty where first is end.
struct PairRange {
    int32_t first, end;
};

/// Return the pairs of separations from low to high: k-vector (Mortari and Neta 2000).
PairRange pairs_between(const Pairs &pairs, double low_rad, double high_rad);

}  // namespace st

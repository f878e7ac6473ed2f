// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Spots of any shape: all flux above the background that is connected.
//
// Coma, trails, colour mosaics, clipping and compression give stars shapes that no model has. Every
// connected spot of the smoothed image above the threshold may be a star, the brightest ones first,
// unless it is as large as a cloud or a building, or a part of the border of something bright: of
// the sky above trees, or of a lit wall. Its position is the centre of its flux, with an error that
// follows its size.

#pragma once

#include "centroid/image.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

constexpr int MOST_SPOTS = 60;
constexpr double CELL_SHARE =
    4.0;  // of its share of the spots, which a cell of the image may have
constexpr int BRIGHT_SPOTS = 12;

/// Append the connected spots of an image, at most MOST_SPOTS, the brightest first; cell_share as in
/// choose(). Calm ones only: not those of trees, buildings and text, which are close together.
void find_spots(const Image &image, double cell_share, bool calm, List<st_centroid> &spots,
                Arena &arena);

/// Return how many of the BRIGHT_SPOTS brightest spots have a star closer than reach_px.
int explained_spots(const List<st_centroid> &spots, const List<st_centroid> &stars,
                    double reach_px);

/// Append to fitted stars other spots that are within the radius of an expected place, brightest
/// first.
void add_near_spots(List<st_centroid> &stars, const List<st_centroid> &spots, const Place *places,
                    const double *radius_px, int count, Arena &arena);

/// Append to fitted stars the bright spots that are not among them, brightest first.
///
/// Faint spots are mostly no stars: as soon as there are BRIGHT_SPOTS, the limit is the flux that a
/// quarter of the fitted ones do not reach. Half of the list of `most` stars is left to these.
void add_spots(List<st_centroid> &stars, const List<st_centroid> &spots, int most, Arena &arena);

/// Order stars by their flux, the brightest first.
void sort_by_flux(List<st_centroid> &stars, Arena &arena);

/// Fill chosen with 1 for the first `most` of places, else 0, with a quota for each of 8 x 8 cells of
/// the image: no cell gets more than cell_share times its share while others have any. Return how
/// many are chosen.
int choose(const Place *places, int count, int width, int height, int most, double cell_share,
           uint8_t *chosen);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What a search has of the sky: pattern stars, their cells, and pairs of them by separation.

#pragma once

#include <cstdint>

#include "sky/sky.h"

namespace st {

/// Stars brightest first, of a sky file or of arrays of the same layout.
struct Patterns {
    int32_t stars;
    const int32_t *hip;
    const double (*direction)[3];
    const double *magnitude;
    const uint8_t *blended;
    Cells cells;
    int32_t in_cells;  // stars that the cells have, of the stars
    Pairs bright_pairs, pairs;
};

/// How many image stars and triangles of the first level, of the brightest pairs.
struct BrightLevel {
    int32_t image_stars, triangles;
};

/// Return the patterns of a sky file.
inline Patterns patterns_of(const SkyFile &sky) {
    return {sky.pattern_stars, sky.hip,           sky.direction,    sky.magnitude, sky.blended,
            sky.pattern_cells, sky.pattern_stars, sky.bright_pairs, sky.pairs};
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The stars of an image that are used to identify it.

#pragma once

#include <cstdint>

#include "camera/lens.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

/// Image stars, brightest first.
struct ImageStars {
    int count;
    int32_t *index;       // rows among the centroids
    Vector3 *direction;   // unit vectors in the sensor frame
    Point *seen;          // undistorted coordinates
    double *sigma;        // errors per axis, rad
    double median_sigma;  // of an even number the greater middle one; 0 without stars
};

/// Return memory for so many stars in an arena, which usable_stars() fills.
ImageStars image_stars(int most, Arena &arena);

/// Use the first usable centroids in an order, each star once; max_stars at most. Their errors
/// include a floor, for those of the camera model. Undistorted coordinates and the median are not
/// set yet.
void usable_stars(const Lens &lens, const st_centroid *centroids, const int32_t *order, int count,
                  int max_stars, double sigma_floor_px, ImageStars &stars);

/// The same of the brightest ones, complete.
void brightest_stars(const Lens &lens, const st_centroid *centroids, int count, int max_stars,
                     double sigma_floor_px, ImageStars &stars, Arena &work);

/// Set undistorted coordinates and the median error of stars with directions and errors.
void complete(bool equidistant, ImageStars &stars, Arena &work);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Which catalogue stars an attitude puts into the image, and where.

#pragma once

#include <cstdint>

#include "camera/lens.h"
#include "maths/arena.h"
#include "sky/apparent.h"

namespace st {

/// In and around the image: most centroids are stars of these.
constexpr int BRIGHT_STARS = 64;

/// A star by an attitude: its direction on sensor axes, and its pixel, NaN for none.
struct StarInView {
    int32_t star;
    Vector3 sensor;
    Point uv;
};

/// The stars in and near the image of attitudes that change little from one to the next.
///
/// near are stars of the sky file, brightest first, within a cone about centre; of the first
/// computed ones direction is the apparent one of a version of the sky. lens is that of the camera,
/// unless a better one is known.
struct StarsInView {
    Lens lens;
    double corner_rad, pixel_rad;
    double cos_corner, cos_ahead;
    Vector3 centre;
    List<int32_t> near;
    Vector3 *natural, *direction;  // (capacity of near)
    uint64_t version;
    int computed;
};

/// Return the capacity for the stars in a cone about the image: several times their mean number.
int stars_in_view_capacity(const SkyFile &file, const Lens &lens);

/// Return the bytes that start_view() takes.
size_t stars_in_view_bytes(int capacity);

/// Start without stars.
void start_view(const Lens &lens, int capacity, Arena &arena, StarsInView &view);

/// Find the stars in and near the image of an attitude; return its matrix.
Matrix3 turn_view(const ApparentSky &sky, const Quaternion &attitude, StarsInView &view);

/// Return the apparent direction of near[i], on ICRF axes.
const Vector3 &direction_in_view(const ApparentSky &sky, int i, StarsInView &view);

/// Return the number of near stars up to a magnitude: the first ones.
int brighter_in_view(const SkyFile &file, double faintest, const StarsInView &view);

/// Fill star, direction and pixel of near[i]; false outside of the cone around the image.
bool see(const ApparentSky &sky, const Matrix3 &attitude, int i, StarsInView &view,
         StarInView &seen);

/// List the stars in the cone around the image, brightest first.
void stars_in_view(const ApparentSky &sky, const Quaternion &attitude, StarsInView &view,
                   List<StarInView> &seen);

/// The same, of at least those within reach_px of some pixels uv (count).
void stars_beside(const ApparentSky &sky, const Quaternion &attitude, const Point *uv, int count,
                  double reach_px, StarsInView &view, List<StarInView> &seen, Arena &work);

/// Put the indices of centroids (count) into left (count) that have no star near; none without a
/// positive sigma. Near is within reach_px, or within reach_sigmas of its sigma. Return how many.
int unexplained(const ApparentSky &sky, const Quaternion &attitude, const st_centroid *centroids,
                int count, double reach_px, double reach_sigmas, StarsInView &view, int32_t *left,
                Arena &work);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The star neighbourhood approach (SNA): association by position, or by distances to neighbours.
//
// Samaan, Mortari and Junkins 2005, the baseline of Sadeghi, Sabahi and Saberali.

#pragma once

#include "camera/lens.h"
#include "maths/arena.h"

namespace st {

/// Return a pixel after a turn of the sensor; turn is exp([w dt]x).
Point propagated(const Lens &lens, const Point &uv, const Matrix3 &turn);

/// Return the bytes of work memory of star_neighbourhood().
size_t star_neighbourhood_bytes(int stars, int centroids);

/// Fill in the index of each star's centroid (stars), -1 where it is missing or ambiguous.
///
/// predicted and the catalogue's directions icrf (stars) are of the known stars, uv and sigma_px per
/// axis of the centroids. First the unique pairs: one centroid in the gate of one star. Then each
/// star with several centroids in its gate is assigned the one that fits the catalogue distances to
/// most of the identified stars best, and each star with an empty gate the only one anywhere that
/// fits them.
void star_neighbourhood(const Lens &lens, double pixel_rad, const Point *predicted,
                        const Vector3 *icrf, int stars, const Point *uv, const double *sigma_px,
                        int centroids, int32_t *assigned, Arena &work);

}  // namespace st

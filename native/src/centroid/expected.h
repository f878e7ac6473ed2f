// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Where predicted stars and targets are in an image, and what their motion explains.

#pragma once

#include "centroid/image.h"
#include "centroid/streak.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

/// Predictions of a time: stars first, brightest first, then targets, whose hip is 0. Where each
/// pixel of the image is cell x cell pixels of the camera, predictions are in those of the camera.
struct Predictions {
    const st_prediction *item;
    int count;
    int64_t stamp_ns;
    int cell;

    int stars() const;
};

/// The predicted centroids at the time of an image.
///
/// places (count) and radius_px of where they are: the first ones are stars, the others targets;
/// anywhere is whether a target may be further away than a window reaches. motion is that of the
/// stars in a second, over the image; interval_s is the time since the image before.
struct Expected {
    Place *places;
    double *radius_px;
    int count, stars;
    bool anywhere;
    Streak motion;
    double speed_px_s, interval_s;

    /// Return near how many of the predicted stars there is a centroid.
    int stars_seen(const List<st_centroid> &centroids) const;

    /// Return the time in which the stars move by a streak; 0 where it is not their motion.
    double exposure_s(const Streak &streak) const;

    /// Whether a streak of the image, whose sign is unknown, lies along the motion.
    bool agrees(const Streak &streak) const;

private:
    double seconds(const Streak &streak) const;
};

/// Return the predicted centroids at a time in an image of this size, in the arena.
Expected expected_at(int64_t stamp_ns, const Predictions &predicted, int width, int height,
                     double interval_s, Arena &arena);

}  // namespace st

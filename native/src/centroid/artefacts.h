// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What contaminates an image is removed: hits of particles, trails, columns and discs.

#pragma once

#include "centroid/frame.h"
#include "centroid/image.h"
#include "centroid/rejection.h"
#include "maths/arena.h"

namespace st {

/// What contaminates an image: hits of particles, or something large.
struct Contamination {
    bool hits, large;

    bool any() const { return hits || large; }
    bool operator!=(const Contamination &other) const {
        return hits != other.hits || large != other.large;
    }
};

/// Return what contaminates the image of a frame.
Contamination find_contamination(const Frame &frame);

/// Return an image without what contaminates it, in the arena, and add the pixels of hits to the
/// rejections.
///
/// mesh is its background, sigma_px the width of its stars. What is removed gets the level of the
/// background.
Image cleaned(const Image &image, const Mesh &mesh, const Contamination &contamination,
              double sigma_px, Rejections &rejections, Arena &arena);

}  // namespace st

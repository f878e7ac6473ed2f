// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Compares each image with the one before; two exposures never have the same noise.

#pragma once

#include "centroid/image.h"
#include "maths/arena.h"

namespace st {

/// First and last row that equal those of the image before; 0 and 0 if none.
struct RowRange {
    int first, last;
};

class StaleRows {
public:
    /// Take memory for images of this size and smaller ones, which stays with it.
    void take_memory(int width, int height, Arena &arena);

    static size_t bytes(int width, int height);

    void reset();

    /// Whether two images in turn have differed in each row that has noise: one that is shown again
    /// and again from the start is not a fault.
    bool vary() const { return vary_; }

    /// Return the rows that equal those of the image before: the upper part of the image, the lower
    /// part, or all of it. Equal rows between others are not a torn frame: the noise of such
    /// images, drawn or compressed, says nothing.
    RowRange find(const Image &image);

private:
    bool is_noisy(const uint16_t *row) const;
    RowRange compare(const Image &image);

    bool vary_ = false;
    // The image before, and the middle of some of its rows.
    int width_ = 0, height_ = 0, bits_ = 0, step_ = 1, rows_ = 0, left_ = 0, columns_ = 0;
    uint16_t *before_ = nullptr;
    uint16_t *work_ = nullptr;
};

}  // namespace st

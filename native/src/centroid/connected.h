// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Spots that are connected: pixels that touch by a side or a corner.

#pragma once

#include "maths/arena.h"

namespace st {

/// The pixels first .. last of a row, and the number of their spot.
struct Run {
    int32_t spot;
    uint16_t first, last;
};

/// The least box about a spot, and its pixels.
struct Box {
    int left, right, top, bottom, pixels;

    /// Add a run of row v; rows follow each other.
    void add(const Run &run, int v) {
        left = pixels == 0 || run.first < left ? run.first : left;
        right = pixels == 0 || run.last > right ? run.last : right;
        top = pixels == 0 ? v : top;
        bottom = v;
        pixels += run.last - run.first + 1;
    }
};

/// The connected spots of an image, whose pixels are given row by row.
///
/// Most of an image is sky: what follows looks at the runs of a spot along its rows alone. Union of
/// sets with halved paths (Tarjan, J. ACM 22, 1975).
class Connected {
public:
    struct Row {
        const Run *first, *last;

        const Run *begin() const { return first; }
        const Run *end() const { return last; }
    };

    /// An image of this size without any spots.
    Connected(int width, int height, Arena &arena);

    /// Add the next row: its pixels above their limits are of spots.
    void add_row(const float *value, const float *limit);

    /// Number the spots from 1 on, in the order of their first pixels, after the last row; return
    /// how many there are.
    int number();

    /// Return the runs of a row, from left to right.
    Row row(int v) const { return {run_ + start_[v], run_ + start_[v + 1]}; }

    /// Return how many pixels of the columns left .. left + side - 1 and the rows from top on are of
    /// spots; beyond its borders the image is mirrored.
    int count_in(int left, int top, int side) const;

    /// Bytes that an image takes.
    static size_t bytes(int width, int height);

    int width() const { return width_; }
    int height() const { return height_; }

private:
    int count_in_row(int v, int left, int right) const;

    int width_, height_;
    Run *run_;
    int *start_;
    uint8_t *above_;
    int32_t *parent_;
    int rows_ = 0;
    int32_t numbers_ = 0;
};

}  // namespace st

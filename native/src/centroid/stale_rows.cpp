// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/stale_rows.h"

#include <cstring>

#include "maths/sorting.h"

namespace st {
namespace {

constexpr int COMPARED = 64;           // rows of an image,
constexpr int COMPARED_COLUMNS = 512;  // of them, in the middle; first one in COMPARED_PX:
constexpr int COMPARED_PX = 32;        // rows that differ there are not equal
constexpr double LEAST_NOISY =
    0.02;  // share of a row's pixels that are not its median, unless it is
           // a dead or a dark row
constexpr double LEAST_ROWS = 0.5;  // share of rows that are noisy: compression leaves few

bool are_equal(const uint16_t *one, const uint16_t *other, int columns) {
    for (int u = 0; u < columns; u += COMPARED_PX) {
        if (one[u] != other[u]) {
            return false;
        }
    }
    return std::memcmp(one, other, sizeof(uint16_t) * static_cast<size_t>(columns)) == 0;
}

}  // namespace

size_t StaleRows::bytes(int width, int height) {
    const auto columns = static_cast<size_t>(width < COMPARED_COLUMNS ? width : COMPARED_COLUMNS);
    const auto rows = static_cast<size_t>(height < 2 * COMPARED ? height : 2 * COMPARED);
    return Arena::padded<uint16_t>(rows * columns) + Arena::padded<uint16_t>(columns);
}

void StaleRows::take_memory(int width, int height, Arena &arena) {
    const auto columns = static_cast<size_t>(width < COMPARED_COLUMNS ? width : COMPARED_COLUMNS);
    const auto rows = static_cast<size_t>(height < 2 * COMPARED ? height : 2 * COMPARED);
    before_ = arena.take<uint16_t>(rows * columns);
    work_ = arena.take<uint16_t>(columns);
}

void StaleRows::reset() {
    vary_ = false;
    bits_ = 0;
}

RowRange StaleRows::find(const Image &image) {
    RowRange found{0, 0};
    if (width_ == image.width && height_ == image.height && bits_ == image.bits) {
        found = compare(image);
    } else {
        width_ = image.width;
        height_ = image.height;
        bits_ = image.bits;
        step_ = height_ / COMPARED > 1 ? height_ / COMPARED : 1;
        rows_ = (height_ + step_ - 1) / step_;
        columns_ = width_ < COMPARED_COLUMNS ? width_ : COMPARED_COLUMNS;
        left_ = (width_ - columns_) / 2;
    }
    for (int i = 0; i < rows_; ++i) {
        std::memcpy(before_ + i * columns_, image.row(i * step_) + left_,
                    sizeof(uint16_t) * static_cast<size_t>(columns_));
    }
    return found;
}

/// Compare the rows of an image with those of the one before.
RowRange StaleRows::compare(const Image &image) {
    bool any = false;
    for (int i = 0; i < rows_ && !any; ++i) {
        any = are_equal(image.row(i * step_) + left_, before_ + i * columns_, columns_);
    }
    if (!any) {
        vary_ = true;
        return {0, 0};
    }
    int noisy = 0, stale = 0, changes = 0, first = 0, last = 0;
    bool is_stale = false;
    for (int i = 0; i < rows_; ++i) {
        const uint16_t *row = image.row(i * step_) + left_;
        if (!is_noisy(row)) {
            continue;
        }
        const bool equal = are_equal(row, before_ + i * columns_, columns_);
        changes += noisy > 0 && equal != is_stale ? 1 : 0;
        is_stale = equal;
        ++noisy;
        if (equal) {
            first = stale == 0 ? i * step_ : first;
            last = i * step_;
            ++stale;
        }
    }
    if (noisy < LEAST_ROWS * rows_) {
        return {0, 0};
    }
    vary_ |= stale == 0;
    if (stale == 0 || changes > 1) {
        return {0, 0};
    }
    // Dark rows above the first one say nothing of an image whose other rows are all equal.
    return {stale == noisy ? 0 : first, is_stale ? image.height - 1 : last};
}

/// Whether a row has the noise of pixels.
bool StaleRows::is_noisy(const uint16_t *row) const {
    std::memcpy(work_, row, sizeof(uint16_t) * static_cast<size_t>(columns_));
    const double middle = median(work_, columns_);
    int other = 0;
    for (int u = 0; u < columns_; ++u) {
        other += row[u] != middle ? 1 : 0;
    }
    return static_cast<double>(other) / columns_ >= LEAST_NOISY;
}

}  // namespace st

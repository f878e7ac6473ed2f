// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/connected.h"

#include <cstring>

#include "centroid/smoothing.h"
#include "maths/clones.h"

namespace st {
namespace {

/// Return the first number of the set of a number.
int32_t first_of(int32_t *parent, int32_t number) {
    while (parent[number] != number) {
        parent[number] = parent[parent[number]];
        number = parent[number];
    }
    return number;
}

/// Unite two sets, 0 for none; return the first number of both.
int32_t united(int32_t *parent, int32_t one, int32_t other) {
    if (one == 0 || other == 0) {
        return one == 0 ? other : one;
    }
    one = first_of(parent, one);
    other = first_of(parent, other);
    const int32_t first = one < other ? one : other;
    parent[one] = parent[other] = first;
    return first;
}

/// Return how many sets there are at most, of pixels with no neighbour before them: one in a square
/// of four. A row has as many runs of each column of these squares.
size_t most_sets(int width, int height) {
    return static_cast<size_t>((width + 1) / 2) * static_cast<size_t>((height + 1) / 2) + 1;
}

size_t most_runs(int width, int height) {
    return static_cast<size_t>((width + 1) / 2) * static_cast<size_t>(height);
}

ST_CLONES void mark_above(const float *__restrict value, const float *__restrict limit, int count,
                          uint8_t *__restrict above) {
    for (int u = 0; u < count; ++u) {
        above[u] = value[u] > limit[u] ? 1 : 0;
    }
}

}  // namespace

Connected::Connected(int width, int height, Arena &arena)
    : width_(width),
      height_(height),
      run_(arena.take<Run>(most_runs(width, height))),
      start_(arena.take<int>(static_cast<size_t>(height) + 1)),
      above_(arena.take<uint8_t>(static_cast<size_t>(width))),
      parent_(arena.take<int32_t>(most_sets(width, height))) {
    start_[0] = 0;
}

size_t Connected::bytes(int width, int height) {
    return Arena::padded<Run>(most_runs(width, height)) +
           Arena::padded<int>(static_cast<size_t>(height) + 1) +
           Arena::padded<uint8_t>(static_cast<size_t>(width)) +
           Arena::padded<int32_t>(most_sets(width, height));
}

void Connected::add_row(const float *value, const float *limit) {
    mark_above(value, limit, width_, above_);
    Row before = rows_ > 0 ? row(rows_ - 1) : Row{run_, run_};
    Run *end = run_ + start_[rows_];
    for (int u = 0; u < width_;) {
        const void *next = std::memchr(above_ + u, 1, static_cast<size_t>(width_ - u));
        if (next == nullptr) {
            break;
        }
        const auto first = static_cast<int>(static_cast<const uint8_t *>(next) - above_);
        for (u = first; u < width_ && above_[u] != 0;) {
            ++u;
        }
        while (before.first != before.last && before.first->last < first - 1) {
            ++before.first;  // it ends before all later ones
        }
        int32_t number = 0;
        for (const Run *one = before.first; one != before.last && one->first <= u; ++one) {
            number = united(parent_, number, one->spot);
        }
        if (number == 0) {
            number = ++numbers_;
            parent_[number] = number;
        }
        *end++ = {number, static_cast<uint16_t>(first), static_cast<uint16_t>(u - 1)};
    }
    start_[++rows_] = static_cast<int>(end - run_);
}

int Connected::number() {
    // A set begins with its first number: those before a number have their final one already.
    int count = 0;
    for (int32_t number = 1; number <= numbers_; ++number) {
        parent_[number] = parent_[number] == number ? ++count : parent_[parent_[number]];
    }
    for (int k = 0; k < start_[rows_]; ++k) {
        run_[k].spot = parent_[run_[k].spot];
    }
    return count;
}

int Connected::count_in(int left, int top, int side) const {
    const int right = left + side;
    int count = 0;
    for (int y = top; y < top + side; ++y) {
        const int v = mirrored(y, height_);
        count += count_in_row(v, left > 0 ? left : 0, right < width_ ? right : width_);
        for (int u = left; u < 0; ++u) {
            count += count_in_row(v, mirrored(u, width_), mirrored(u, width_) + 1);
        }
        for (int u = width_; u < right; ++u) {
            count += count_in_row(v, mirrored(u, width_), mirrored(u, width_) + 1);
        }
    }
    return count;
}

/// Return how many pixels left .. right - 1 of a row are of spots.
int Connected::count_in_row(int v, int left, int right) const {
    const Row runs = row(v);
    const Run *first = runs.first;
    for (auto left_over = runs.last - runs.first; left_over > 0;) {
        const auto half = left_over / 2;
        const bool earlier = first[half].last < left;
        first += earlier ? half + 1 : 0;
        left_over = earlier ? left_over - half - 1 : half;
    }
    int count = 0;
    for (; first != runs.last && first->first < right; ++first) {
        count += (first->last < right ? first->last + 1 : right) -
                 (first->first > left ? first->first : left);
    }
    return count;
}

}  // namespace st

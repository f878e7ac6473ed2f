// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/connected.h"

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

}  // namespace

int connect(const Plane<int32_t> &spot, Arena &arena) {
    const Arena::Scope scope(arena);
    const int width = spot.width;
    // Pixels with no neighbour before them begin a number: at most one in a square of four.
    auto *parent = arena.take<int32_t>(
        static_cast<size_t>((width + 1) / 2) * static_cast<size_t>((spot.height + 1) / 2) + 1);
    int32_t numbers = 0;
    for (int v = 0; v < spot.height; ++v) {
        int32_t *row = spot.row(v);
        const int32_t *above = v > 0 ? spot.row(v - 1) : nullptr;
        for (int u = 0; u < width; ++u) {
            if (row[u] == 0) {
                continue;
            }
            int32_t number = u > 0 ? row[u - 1] : 0;
            if (above != nullptr) {
                for (int x = u > 0 ? u - 1 : 0; x <= u + 1 && x < width; ++x) {
                    number = united(parent, number, above[x]);
                }
            }
            if (number == 0) {
                number = ++numbers;
                parent[number] = number;
            }
            row[u] = number;
        }
    }
    // A set begins with its first number: those before a number have their final one already.
    int count = 0;
    for (int32_t number = 1; number <= numbers; ++number) {
        parent[number] = parent[number] == number ? ++count : parent[parent[number]];
    }
    for (int k = 0; k < spot.size(); ++k) {
        spot.value[k] = spot.value[k] == 0 ? 0 : parent[spot.value[k]];
    }
    return count;
}

}  // namespace st

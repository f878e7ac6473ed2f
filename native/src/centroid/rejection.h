// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Spots left out, by reason.

#pragma once

#include "maths/arena.h"
#include "startracker.h"

namespace st {

/// Counts each rejected spot once, under the first reason that holds, with its position; all are
/// counted, those that fit are listed.
struct Rejections {
    List<st_rejected> spots;
    int by_kind[ST_REJECTED_COUNT] = {};

    void add(st_rejection kind, double u, double v) {
        ++by_kind[kind];
        spots.add({u, v, kind, 0});
    }

    void clear() {
        spots.clear();
        for (int &one : by_kind) {
            one = 0;
        }
    }

    /// Add all spots of another list.
    void include(const Rejections &other) {
        for (int kind = 0; kind < ST_REJECTED_COUNT; ++kind) {
            by_kind[kind] += other.by_kind[kind];
        }
        spots.add_all(other.spots);
    }

    int count() const {
        int sum = 0;
        for (const int one : by_kind) {
            sum += one;
        }
        return sum;
    }
};

}  // namespace st

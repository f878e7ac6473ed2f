// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Frames within the horizon, each with the motion after it, in the order of their stamps.

#pragma once

#include "fusion/head.h"
#include "maths/arena.h"

namespace st {

/// A frame and the motion after it; of the modes what is in use, without gaps.
struct FusionEntry {
    HeadFrame frame;
    int head;
    MotionSummary<MOST_CONSTANTS> summary;
    double *modes;

    int64_t stamp_ns() const { return summary.stamp_ns; }

    /// Keep a motion, and fill one with what was kept.
    void store(const HeadFrame &of, int of_head, const BodyMotionState &motion);
    void store(const BodyMotionState &motion);
    void load(BodyMotionState &motion) const;

    /// Add a variance of the first three of a head's coefficients.
    void widen(const Columns &columns, double variance);
};

class History {
public:
    static size_t bytes(int capacity, int coefficients);

    void start(int capacity, int coefficients, Arena &arena);

    int count() const { return count_; }
    void clear() { count_ = 0; }

    FusionEntry &operator[](int index) { return entries_[order_[index]]; }
    const FusionEntry &operator[](int index) const { return entries_[order_[index]]; }
    FusionEntry &newest() { return (*this)[count_ - 1]; }
    const FusionEntry &newest() const { return (*this)[count_ - 1]; }

    /// Return where a frame of a stamp belongs: behind those that are not later.
    int place_of(int64_t stamp_ns) const;

    /// Make room for a frame there; there is always room for one more than the capacity.
    FusionEntry &insert(int index);

    /// Forget frames up to a stamp, but not the newest one before it, and those beyond the
    /// capacity.
    void forget_until(int64_t stamp_ns);

private:
    // order_ lists the entries, oldest first; those from count_ on are free.
    FusionEntry *entries_;
    int *order_;
    int capacity_, count_;
};

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Steps of mounts: one head's attitude against the reference's, before and after a time.
//
// The difference of two heads has no error of the attitude. Over the last WINDOW_S it is fitted by
// a parabola, for slow bending, and by the law of the mount, with and without a step at the border
// of two blocks: the generalised likelihood ratio is the chi-square of the step.

#pragma once

#include <cstdint>

#include "fusion/fused_state.h"
#include "maths/arena.h"
#include "startracker_fusion.h"

namespace st {

constexpr double BLOCK_S = 10.0, WINDOW_S = 900.0;
constexpr int MOST_BLOCKS = 90;  // in a window
constexpr int MOST_LAW = MOST_TERMS - 1;

/// phi of a mount but the 1.
struct Law {
    int count;
    double phi[MOST_LAW];
};

/// Weighted sums of the offsets of one head over a block, and of its law.
struct StepBlock {
    int count;
    Vector3 weight, total, squares;
    Law law;
};

/// A head minus the reference in a block: its variance by that of the frames, and by their
/// scatter.
struct Difference {
    int64_t number;
    Vector3 offset_rad, variance, scatter;
    Law law;
};

/// The differences of a head, oldest first.
struct Series {
    int count;
    Difference of[MOST_BLOCKS];
};

class StepDetector {
public:
    /// Start without frames; series is memory for one of each head.
    void start(int heads, Series *series);

    /// Forget all frames.
    void restart();

    /// Add the attitude of a head minus that of the state; list the steps that are found now.
    void add(int head, int64_t stamp_ns, const Vector3 &offset_rad, const Vector3 &variance_rad2,
             const Law &law, List<st_mount_step> &found);

private:
    void close(List<st_mount_step> &found);

    int heads_;
    Series *series_;
    bool has_block_;
    int64_t number_;
    StepBlock block_[ST_MOST_HEADS];
};

/// Fill the most significant step of a series; false where there is none.
bool find_step(const Series &series, st_mount_step &step);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Frames of a source that is frozen: two exposures never have the same noise.

#pragma once

#include "track/frame.h"

namespace st {

/// Compares each frame of centroids with the one before it that has any.
class Repetition {
public:
    Repetition() = default;
    Repetition(int centroids, Arena &arena)
        : before_(arena.list<Point>(static_cast<size_t>(centroids))) {}

    void reset() {
        before_.clear();
        vary_ = false;
    }

    /// Add a frame; return whether it is the one before, of a source whose frames have differed. A
    /// frame that is shown again and again from the start is not a fault.
    bool add(const CentroidFrame &frame);

private:
    List<Point> before_;
    bool vary_ = false;
};

}  // namespace st

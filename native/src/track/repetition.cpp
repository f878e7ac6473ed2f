// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/repetition.h"

#include <cmath>

#include "integrity/checks.h"

namespace st {

bool Repetition::add(const CentroidFrame &frame) {
    if (frame.count == 0) {
        return false;
    }
    const st_centroid &brightest = frame.centroid[0];
    double nearest_px = INFINITY;
    bool same = before_.count == frame.count;
    for (int m = 0; m < before_.count; ++m) {
        const Point &one = before_[m];
        nearest_px =
            std::fmin(nearest_px, std::hypot(one.x - brightest.u_px, one.y - brightest.v_px));
        same = same && one.x == frame.centroid[m].u_px && one.y == frame.centroid[m].v_px;
    }
    vary_ = vary_ || (before_.count > 0 && nearest_px > limit(checks::REPEATED_FRAME, "moved_px"));
    before_.clear();
    for (const st_centroid &one : frame) {
        before_.add({one.u_px, one.v_px});
    }
    return vary_ && same;
}

}  // namespace st

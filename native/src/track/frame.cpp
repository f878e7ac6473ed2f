// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/frame.h"

namespace st {

bool is_rolling(const CentroidFrame &frame) {
    for (const st_centroid &one : frame) {
        if (one.delay_s != 0) {
            return true;
        }
    }
    return false;
}

bool are_streaks(const CentroidFrame &frame) {
    for (const st_centroid &one : frame) {
        if (one.cov_uu_px2 != one.cov_vv_px2 || one.cov_uv_px2 != 0) {
            return true;
        }
    }
    return false;
}

}  // namespace st

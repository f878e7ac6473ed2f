// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/frame.h"

namespace st {

bool is_rolling(const Frame &frame) {
    for (const st_centroid &one : frame) {
        if (one.delay_s != 0) {
            return true;
        }
    }
    return false;
}

bool are_streaks(const Frame &frame) {
    for (const st_centroid &one : frame) {
        if (one.cov_uu_px2 != one.cov_vv_px2 || one.cov_uv_px2 != 0) {
            return true;
        }
    }
    return false;
}

bool common_error(const Frame &frame, Covariance2 &common) {
    const st_centroid *largest = nullptr;
    bool any = false;
    for (const st_centroid &one : frame) {
        any = any || one.common_uu_px2 != 0 || one.common_uv_px2 != 0 || one.common_vv_px2 != 0;
        if (largest == nullptr || one.common_uu_px2 + one.common_vv_px2 >
                                      largest->common_uu_px2 + largest->common_vv_px2) {
            largest = &one;
        }
    }
    if (any) {
        common = {largest->common_uu_px2, largest->common_uv_px2, largest->common_vv_px2};
    }
    return any;
}

}  // namespace st

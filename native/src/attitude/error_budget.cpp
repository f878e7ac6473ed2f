// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "attitude/error_budget.h"

namespace st {

Matrix3 covariance_of(const st_budget &budget) {
    const double (*const terms[])[3][3] = {&budget.stars,    &budget.motion,  &budget.exposure,
                                           &budget.stamps,   &budget.shutter, &budget.lens,
                                           &budget.observer, &budget.epoch};
    Matrix3 P{};
    for (const auto *term : terms) {
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                P[i][j] += (*term)[i][j];
            }
        }
    }
    return P;
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Reasons with their figures.

#pragma once

#include <initializer_list>

#include "startracker.h"

namespace st {

/// Return a reason with its figures, in the order that st_reason_code names them.
inline st_reason reason_of(int32_t code, std::initializer_list<double> figures) {
    st_reason reason{code, 0, {}};
    int k = 0;
    for (const double figure : figures) {
        reason.figure[k++] = figure;
    }
    return reason;
}

}  // namespace st

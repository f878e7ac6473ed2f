// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/image.h"

#include "maths/clones.h"

namespace st {

ST_CLONES void widen_row(const uint8_t *__restrict row, int count, uint16_t *__restrict copy) {
    for (int u = 0; u < count; ++u) {
        copy[u] = row[u];
    }
}

}  // namespace st

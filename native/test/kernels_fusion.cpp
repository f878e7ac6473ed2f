// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "kernels_fusion.h"

#include "fusion/steps.h"

using namespace st;

namespace {

Series series[ST_MOST_HEADS];

}  // namespace

int32_t stt_find_steps(int32_t heads, int32_t count, const int32_t *head, const int64_t *stamp_ns,
                       const double *offset, const double *variance, int32_t laws,
                       const double *law, st_mount_step *steps, int32_t capacity) {
    StepDetector detector;
    detector.start(heads, series);
    List<st_mount_step> found{steps, 0, capacity, 0};
    for (int k = 0; k < count; ++k) {
        Law of{laws, {}};
        Vector3 rad, rad2;
        for (int i = 0; i < 3; ++i) {
            rad[i] = offset[3 * k + i];
            rad2[i] = variance[3 * k + i];
            of.phi[i] = i < laws ? law[laws * k + i] : 0.0;
        }
        detector.add(head[k], stamp_ns[k], rad, rad2, of, found);
    }
    return found.count;
}

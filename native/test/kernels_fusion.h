// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* Parts of the fusion of heads for tests, as kernels.h; the fusion itself is
 * startracker_fusion.h. */

#ifndef STARTRACKER_TEST_KERNELS_FUSION_H
#define STARTRACKER_TEST_KERNELS_FUSION_H

#include "startracker_fusion.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The steps that a detector finds in offsets (count, 3) of variance (count, 3) and law (count,
 * laws) of heads; returns how many, at most capacity. */
ST_API int32_t stt_find_steps(int32_t heads, int32_t count, const int32_t *head,
                              const int64_t *stamp_ns, const double *offset,
                              const double *variance, int32_t laws, const double *law,
                              st_mount_step *steps, int32_t capacity);

#ifdef __cplusplus
}
#endif

#endif

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* The blind search of photographs for tests, as kernels.h. */

#ifndef STARTRACKER_TEST_KERNELS_BLIND_H
#define STARTRACKER_TEST_KERNELS_BLIND_H

#include "startracker_ground.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The code (4) of stars A to D in the order that they have; 0 where they have none. */
ST_API int32_t stt_quad_code(const double *direction, const int32_t *four, double *code);
ST_API double stt_few_star_probability(int32_t n, int32_t m, int32_t j, int32_t k, int32_t stars,
                                       double square, double order, double width, double height,
                                       double scale_error);
/* The pixel (2) of a direction and its derivatives (2, 11), of a lens with its parameters changed. */
ST_API void stt_linearised(const st_camera *camera, const double *quaternion, const double *change,
                           const double *icrf, int32_t parameters, double *pixel, double *partial);

#ifdef __cplusplus
}
#endif

#endif

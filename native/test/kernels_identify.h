// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* The identification of stars for tests, as kernels.h. Trackers are of st_create_for(). */

#ifndef STARTRACKER_TEST_KERNELS_IDENTIFY_H
#define STARTRACKER_TEST_KERNELS_IDENTIFY_H

#include "startracker_ground.h"

#ifdef __cplusplus
extern "C" {
#endif

ST_API double stt_binomial_tail(int32_t m, int32_t n, double p);
ST_API double stt_fisher_combined(double product);
ST_API int32_t stt_least_matches(int32_t n, double p, double share, int32_t base,
                                 double tolerance_sigmas, double tested, double most);
/* Of image stars seen (count, 2), their catalogue stars and residuals, without a turn. */
ST_API int32_t stt_lens_mismatch(const st_tracker *tracker, const double *seen,
                                 const int32_t *star, const double *residual, int32_t count,
                                 double radius, double sigma, int32_t m, double p);
/* The range of sorted values (count) from low to high, by their k-vector. */
ST_API void stt_range(const double *values, const int32_t *below, int32_t count, double low,
                      double high, int32_t range[2]);
/* The best candidates (5, 3) of an image triangle, how many they are, and how many fit; most_ns of
 * work. */
ST_API double stt_triangles(st_tracker *tracker, const st_image_stars *stars,
                            const int32_t base[3], double most_ns, int32_t *best, int32_t *count);
/* Triangles (most, 3) in the order in which they are looked up; returns how many. */
ST_API int32_t stt_triangle_order(st_tracker *tracker, const st_image_stars *stars,
                                  int32_t *triangle, int32_t most);
ST_API int32_t stt_is_searched(st_tracker *tracker, double median_sigma, int32_t count,
                               double looked_up, double cost_ns, double tested,
                               double false_alarm_max);
/* Stars in the image by a matrix to ICRF. */
ST_API int32_t stt_stars_in_image(const st_tracker *tracker, const double matrix[9]);

#ifdef __cplusplus
}
#endif

#endif

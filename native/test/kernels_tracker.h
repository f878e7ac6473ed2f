// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* Defects of a tracker, by which tests see what it does about them; the epoch of its sky. */

#ifndef STARTRACKER_TEST_KERNELS_TRACKER_H
#define STARTRACKER_TEST_KERNELS_TRACKER_H

#include "startracker.h"

#ifdef __cplusplus
extern "C" {
#endif

/* All modes of the motion are at an attitude and a rate, and sure of it: variance of each element. */
ST_API void stt_set_motion(st_tracker *tracker, const double quaternion[4], const double rate[3],
                           double variance);

/* The variance of an element of the error state of all modes. */
ST_API void stt_set_variance(st_tracker *tracker, int32_t element, double variance);

ST_API void stt_earth_position_au(double year, double position[3]);

#ifdef __cplusplus
}
#endif

#endif /* STARTRACKER_TEST_KERNELS_TRACKER_H */

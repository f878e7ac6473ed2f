// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Tools on the ground: single images, for photographs, data sheets and tests. A flight program needs
 * startracker.h alone.
 *
 * Each call uses the memory of a tracker with the stage ST_EXTRACTS, and its options, but nothing of
 * what the tracker knows of images before, which stays. The lists of what was found are those of
 * st_centroids() and st_rejections(). Images are of the size of the camera, their cell is 1.
 */

#ifndef STARTRACKER_GROUND_H
#define STARTRACKER_GROUND_H

#include "startracker.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Motion of the stars in the exposure at a pixel, about which the image rolls. */
typedef struct {
    double u_px, v_px, roll_rad, at_u_px, at_v_px;
} st_streak;

typedef struct {
    double threshold_factor; /* 1; another one falsifies the threshold of means of pixels */
    int32_t most_stars;      /* 0: max_stars of the options */
    int32_t points_only;     /* 1: no streaks, no wide stars, no spots of other shapes */
    int32_t narrow;          /* 1: the width of stars is that of the narrowest spots */
    int32_t reserved;
} st_search_options;

/* Bytes of what a searched image leaves for those after it: its background, the width of its stars.
 * The caller keeps it, aligned to 64 bytes, and may copy it. */
ST_API st_status st_searched_size(const st_tracker *tracker, size_t *bytes);

/* The stars of a whole image. streak is the motion in the exposure, null where not known; before is
 * what an image before has left, or null. *kept is 1 where after was filled. */
ST_API st_status st_search(st_tracker *tracker, const st_image *image,
                           const st_search_options *options, const st_streak *streak,
                           const void *before, void *after, int32_t *kept,
                           st_extraction *extraction);

/* The stars within radius_px (count) of places (count, 2) in an image of the size and the type of the
 * one that has left before; null streak: points. */
ST_API st_status st_search_near(st_tracker *tracker, const st_image *image, const double *places,
                                const double *radius_px, size_t count, const st_streak *streak,
                                const void *before, void *after, st_extraction *extraction);

/* Connected spots of any shape, in st_centroids(); none of 8 x 8 cells of the image gets more than
 * cell_share of its share. calm 1: not those of trees, buildings and text. */
ST_API st_status st_find_spots(st_tracker *tracker, const st_image *image, double cell_share,
                               int32_t calm);

/* Place and PSF sigma (capacity, 3) in px of the stars of the highest peaks of an image that has left
 * searched, each fitted by itself. */
ST_API st_status st_measure_widths(st_tracker *tracker, const st_image *image,
                                   const void *searched, double *widths, size_t capacity,
                                   size_t *count);

/* Where the image saturates, infinity where nothing in it does. */
ST_API st_status st_full_scale(st_tracker *tracker, const st_image *image, double background_dn,
                               double *full_scale_dn);

/* ---- checks of integrity: docs/integrity.md has their evidence and what follows ------------- */

#define ST_MOST_LIMITS 6

typedef struct {
    const char *name; /* with its unit */
    double value;
} st_limit;

/* The action follows where the evidence is beyond the threshold, or beyond limits. */
typedef struct {
    const char *name;
    double probability; /* of the threshold by chance; 0: the evidence has no known distribution */
    double threshold;   /* chi-square that is exceeded with it; 0 without dof */
    int32_t dof;
    int32_t frames; /* looked at, in a row or the first; 0: the one */
    int32_t reason; /* st_reason_code of what a user sees; 0: another hypothesis, or a figure */
    int32_t limits;
    st_limit limit[ST_MOST_LIMITS];
} st_check;

/* All checks, constants of the library. */
ST_API const st_check *st_checks(size_t *count);

#ifdef __cplusplus
}
#endif

#endif /* STARTRACKER_GROUND_H */

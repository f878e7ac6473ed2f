// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Tools on the ground: single images, candidates for their stars, tracks of single stars, fits of single
 * frames and orbits, for photographs, reprocessing, methods of papers and tests. A flight program needs
 * startracker.h alone.
 *
 * Each call for an image uses the memory of a tracker with the stage ST_EXTRACTS, and its options,
 * but nothing of what the tracker knows of images before, which stays. The lists of what was found are those of
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

/* ---- identification by arrays -------------------------------------------------------------- */

/* Pairs of stars by separation, as sections pair_* of a sky file. No array is copied or checked. */
typedef struct {
    const int32_t *star;
    const double *direction, *separation_rad;
    const int32_t *below, *member, *previous;
    int32_t stars, pairs;
} st_pairs;

/* Pattern stars, brightest first, and their cells, as in a sky file; no pairs where only candidates
 * are verified. Of the brightest pairs so many image stars and triangles are looked up first. */
typedef struct {
    const int32_t *hip;
    const double *direction, *magnitude;
    const uint8_t *blended;
    const int32_t *start, *member;
    st_pairs bright, pairs;
    double scale_error; /* of the focal length, a share, in place of fov_error_percent */
    int32_t stars, cells;
    int32_t bright_image_stars, bright_triangles;
    int32_t most_centroids;
    int32_t bases_by_brightness; /* 1: how candidates were chosen, which is then no evidence */
    int32_t lens_unknown;        /* 1: near misses are expected, as the lens is fitted later */
    int32_t reserved;
} st_patterns;

/* As st_size() and st_create(), for a tracker that identifies stars by these patterns. sky is for its
 * other stages, null where it has none: a file with stars alone, no patterns, is enough. */
ST_API st_status st_size_for(const st_config *config, const st_camera *camera, const st_sky *sky,
                             const st_patterns *patterns, size_t *bytes);
ST_API st_status st_create_for(void *memory, size_t bytes, const st_config *config,
                               const st_camera *camera, const st_sky *sky,
                               const st_patterns *patterns, st_tracker **tracker, st_fault *fault);

/* Unit vectors (count, 3) of image stars, brightest first, with errors per axis in rad; count is
 * max_image_stars at most. */
typedef struct {
    const double *direction, *sigma_rad;
    int32_t count;
    int32_t reserved;
} st_image_stars;

typedef struct {
    st_attitude attitude;
    double focal_ratio;
    double false_alarm_probability; /* 1: rejected */
} st_verification;

/* The first usable centroids in an order (given), each star once: index (count) of them, their
 * direction (count, 3) and sigma_rad (count) with that floor. count is a capacity, then how many
 * there are. */
ST_API st_status st_usable_stars(const st_camera *camera, const st_centroid *centroids,
                                 const int32_t *order, size_t given, double sigma_floor_px,
                                 int32_t *index, double *direction, double *sigma_rad,
                                 size_t *count);

/* How much other image stars support that three of them, base (3), are the pattern stars of each
 * candidate (count, 3). */
ST_API st_status st_support(st_tracker *tracker, const st_image_stars *stars, const int32_t *base,
                            const int32_t *candidates, size_t count, double *support);

/* Verify that image stars base (based) are pattern stars of these numbers, after so many tested
 * candidates; star, residual_px and residual_rad (count) are of each image star, -1 or NaN. */
ST_API st_status st_verify(st_tracker *tracker, const st_image_stars *stars, const int32_t *base,
                           const int32_t *pattern, size_t based, double tested,
                           st_verification *verification, int32_t *star, double *residual_px,
                           double *residual_rad);

/* The most probable of candidates: image stars base (count, 4) may be the pattern stars (count, 4).
 * Those with less support of others are not verified. best is -1 where all are rejected. */
ST_API st_status st_verify_quads(st_tracker *tracker, const st_image_stars *stars,
                                 const int32_t *base, const int32_t *pattern, size_t count,
                                 double least_support, double tested, int32_t *best,
                                 double *false_alarm_probability);

/* ---- the filter of single stars ------------------------------------------------------------- */

/* gate is a squared Mahalanobis distance, gate_probability that of a detected star to be inside it,
 * detection_probability that of a star to have a centroid, image_px2 the area of the image. clutter_px2
 * is the density of false centroids; 0: as association, an st_association, has it. */
typedef struct {
    double gate, gate_probability, detection_probability, image_px2, clutter_px2;
    int32_t association, reserved;
} st_detection;

/* Bytes of memory of st_cycle() for so many tracks and centroids at most, aligned to 64. */
ST_API st_status st_cycle_size(size_t tracks, size_t centroids, size_t *bytes);

/* A cycle of the filter of Sadeghi, Sabahi and Saberali, as the tracker does it for constant_velocity and
 * coordinated_turn: prediction, JPDA, update. state (tracks, 4) is [u, u_rate, v, v_rate] in px and
 * px/s with covariance (tracks, 4, 4); transition and noise (4, 4); centroids uv (centroids, 2) of
 * variance (centroids) px^2 per axis. probability (tracks, centroids + 1), null or filled, has that of a
 * missed star first. All are finite, variances positive, covariances positive semidefinite. */
ST_API st_status st_cycle(void *memory, size_t bytes, const st_detection *detection,
                          const double transition[16], const double noise[16], double *state,
                          double *covariance, size_t tracks, const double *uv,
                          const double *variance, size_t centroids, double *probability);

/* ---- the stars of one frame by themselves --------------------------------------------------- */

/* Apparent direction (count, 3) on ICRF axes, place uv (count, 2) and sigma_px (count) of each. */
typedef struct {
    const double *direction, *uv, *sigma_px;
    int32_t count, reserved;
} st_tracked_stars;

/* turn_rad about sensor axes to the best fit, with its covariance; lens are the normal equations of changes
 * f of the focal ratio and k of k1, the attitude eliminated: ff, fk, kk, f, k. No stars: less than
 * four have a centroid. */
typedef struct {
    double turn_rad[3], covariance_rad2[3][3], lens[5];
    int32_t stars, reserved;
} st_frame_fit;

/* Fit, about an attitude, the stars that have one of the centroids uv (centroids, 2) within 5 sigma. star
 * and centroid (fit->stars) are these pairs, residual (fit->stars, 2) rad to the east and north of each
 * star, as the others see it, sigma_rad (fit->stars); the capacity of all is stars->count. camera is one
 * that st_check_camera() accepts. */
ST_API st_status st_fit_frame(const st_camera *camera, const double quaternion[4],
                              const st_tracked_stars *stars, const double *uv,
                              const double *sigma_px, size_t centroids, st_frame_fit *fit,
                              int32_t *star, int32_t *centroid, double *residual,
                              double *sigma_rad);

/* ---- orbits -------------------------------------------------------------------------------- */

/* Of a body that turns about z: a point mass and its J2, for an equatorial radius. */
typedef struct {
    double mu_m3_s2, radius_m, j2;
} st_gravity;

/* Advance a state, position in m and velocity in m/s, by so many steps. */
ST_API void st_propagate_orbit(const st_gravity *gravity, double step_s, int32_t steps,
                               double state[6]);

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

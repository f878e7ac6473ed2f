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
/* ---- attitudes by themselves --------------------------------------------------------------- */

/* The attitude of directions sensor and icrf (count, 3) to the same stars, of any length, with errors
 * sigma_rad (count), by an st_solver; residual_rad (count) is the angle of each. The reason is why
 * there is none. work has 512 bytes and 64 for each star. */
ST_API st_status st_fit_attitude(int32_t solver, const double *sensor, const double *icrf,
                                 const double *sigma_rad, size_t count, st_attitude *attitude,
                                 double *residual_rad, st_reason *reason, void *work,
                                 size_t bytes);

/* The protection level about sensor axes of an attitude of this covariance: docs/integrity.md. Rows of
 * stars (count, 5) are direction, sigma_rad and residual_rad; rejected is how many more were found
 * to be false. */
ST_API st_status st_protection_level(const double covariance_rad2[9], const double *stars,
                                     size_t count, double misleading_probability,
                                     double false_star_probability, int32_t rejected,
                                     double level_rad[3]);

/* ---- blind search of photographs ----------------------------------------------------------- */

/* The pairs i < j (found, 2) of stars direction (stars, 3) within a chord, and squared chords (found).
 * The stars are by the cells of a cube, cells along each axis: those of cell c are member from
 * start[c] to start[c + 1]. found is a capacity, then how many there are. */
ST_API st_status st_pairs_within(const double *direction, size_t stars, const int32_t *start,
                                 const int32_t *member, int32_t cells, double chord,
                                 int32_t *pairs, double *square, size_t *found);

#define ST_QUAD_CELLS 26 /* of codes of quads along x, 0 to 1; twice as many along y, -1 to 1 */
#define ST_MOST_QUAD_INNER 4

/* Quads of the sky in the order of the cells of their codes: code (quads, 4), side_rad (quads) of
 * A B; those of cell c are start[c] to start[c + 1]. No array is copied or checked. */
typedef struct {
    const float *code, *side_rad;
    const int32_t *start;
} st_quad_table;

/* The quads of a table that have the code of one of quads (count, 4) of image stars, whose direction
 * (stars, 3) may be NaN, within a tolerance. The side of the sky is low to high times that of the
 * image. image (found, 4) are stars in the order of the code, row (found) those of the table, ratio
 * (found) of the sides. found is a capacity, then how many there are. */
ST_API st_status st_match_quads(const st_quad_table *table, const double *direction, size_t stars,
                                const int32_t *quads, size_t count, double tolerance, double low,
                                double high, int32_t *image, int32_t *row, double *ratio,
                                size_t *found);

/* The quads with A and B in pairs (count, 2) of the stars direction (stars, 3), C and D two of the
 * most_inner brightest ones between them: code and star (found, 4), side_rad (found). Neighbours of
 * star s, brightest first, are start[s] to start[s + 1]. most_inner (most_inner - 1) / 2 quads of
 * each pair have room; found is how many there are. */
ST_API st_status st_make_quads(const double *direction, size_t stars, const int32_t *pairs,
                               size_t count, const int32_t *neighbour, const int32_t *start,
                               int32_t most_inner, float *code, int32_t *star, float *side_rad,
                               size_t *found);

#define ST_TRIANGLE_CELLS 40 /* of codes of triangles along each axis */

/* Triangles of the sky in the order of the cells of their codes, then of the longest side: side_rad
 * (triangles, 3), the longest first, star (triangles, 3) opposite; those of cell c are start[c] to
 * start[c + 1]. neighbour (stars, neighbours) are the bright stars about each one, -1 where there
 * are fewer; low_rad to high_rad are the longest sides. No array is copied or checked. */
typedef struct {
    const float *side_rad;
    const int32_t *star, *start, *neighbour;
    double low_rad, high_rad;
    int32_t neighbours;
    int32_t reserved;
} st_triangle_table;

/* All triangles of the stars direction (stars, 3) with sides of partners: the fainter ones of star s
 * are start[s] to start[s + 1]. side_rad and star (found, 3), cell (found) of the code. found is a
 * capacity, then how many there are. */
ST_API st_status st_make_triangles(const double *direction, size_t stars, const int32_t *partner,
                                   const int32_t *start, double shortest_rad,
                                   double least_longest_rad, double longest_rad, float *side_rad,
                                   int32_t *star, int32_t *cell, size_t *found);

/* The most probable triangle of image stars, or the first below false_alarm_max, by so much work, as
 * st_verify(): a few stars among many false spots. Work is the time that it is expected to take on
 * a processor of 3 GHz; *work_s beyond most_work_s: not all was searched. */
ST_API st_status st_few_stars(st_tracker *tracker, const st_image_stars *stars,
                              const st_triangle_table *table, double false_alarm_max,
                              double most_work_s, st_verification *verification, int32_t *star,
                              double *residual_px, double *residual_rad, double *work_s);

/* Directions of a catalogue (stars, 3) too large for a sky file, and their cells. */
typedef struct {
    const float *direction;
    const int32_t *start, *member;
    int32_t stars, cells;
} st_star_cells;

/* How much other image stars support that base (count, 4) are the stars (count, 4) of a catalogue,
 * as far as it is beyond least. */
ST_API st_status st_support_in_cells(const st_star_cells *sky, const st_image_stars *stars,
                                     double tolerance_sigmas, const int32_t *base,
                                     const int32_t *star, size_t count, double least,
                                     double *support);

#define ST_MOST_LENS_PARAMETERS 11

/* Where the fit of a lens begins. free are prior standard deviations of its parameters: a turn about
 * sensor axes (3), rad, logarithms of focal length and pixel ratio, principal point (2) in widths of
 * the image, and the radial terms from k1 on. */
typedef struct {
    st_camera start;
    double free[ST_MOST_LENS_PARAMETERS];
    int32_t parameters; /* 8 .. 11 */
    int32_t reserved;
} st_lens_prior;

/* A lens that is fitted to one image; covariance is that of its parameters. */
typedef struct {
    st_camera camera;
    double quaternion[4]; /* q_icrf_from_sensor */
    double covariance[ST_MOST_LENS_PARAMETERS][ST_MOST_LENS_PARAMETERS];
    double error_px;    /* per axis, that the residuals show */
    double probability; /* of st_grow_lens(): that its matches are chance */
    int32_t folds;      /* 1: it folds the image over itself, or is not a lens */
    int32_t reserved;
} st_fitted_lens;

/* Unit vectors direction (stars, 3) in ICRF; places spot_px (spots, 2), sigma_px (spots). */
typedef struct {
    const double *direction, *spot_px, *sigma_px;
    int32_t stars, spots;
} st_sky_and_spots;

/* Fit a lens, from the camera and the attitude that it has, to spots whose stars are known: star
 * (spots), -1 for none. The three calls need work of 512 bytes and 32 for each spot. */
ST_API st_status st_fit_lens(const st_lens_prior *prior, const st_sky_and_spots *seen,
                             const int32_t *star, st_fitted_lens *lens, void *work, size_t bytes);

/* The star (spots), one to one, -1 for none, in whose gate by a fitted lens of so many parameters
 * each spot is. */
ST_API st_status st_gated_stars(const st_fitted_lens *lens, int32_t parameters, double error_px,
                                const st_sky_and_spots *seen, int32_t *star, void *work,
                                size_t bytes);

/* The most probable of the lenses that are grown from candidates: spots (count, 4) may be the stars
 * (count, 4), in a lens whose focal length is that of the prior over ratio (count). */
ST_API st_status st_grow_lens(const st_lens_prior *prior, const st_sky_and_spots *seen,
                              const int32_t *spots, const int32_t *stars, const double *ratio,
                              size_t count, st_fitted_lens *lens, int32_t *star, void *work,
                              size_t bytes);

/* The stars direction (stars, 3) that a camera of an attitude shows: index and pixel (count, 2), which
 * have room for all. */
ST_API st_status st_stars_in_image(const st_camera *camera, const double quaternion[4],
                                   const double *direction, size_t stars, int32_t *index,
                                   double *pixel, size_t *count);

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

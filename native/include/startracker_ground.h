// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Ground tools for photographs, reprocessing, published methods and tests: single images,
 * candidates, filters of single stars, fits of single frames, orbits. A flight program needs
 * startracker.h only.
 *
 * Calls for an image use memory and options of a tracker with the stage ST_EXTRACTS, and neither
 * use nor change its state. st_centroids() and st_rejections() return the lists. Images have the
 * size of the camera and cell 1.
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
    double threshold_factor; /* of the threshold of weighted means, 1 by default */
    int32_t most_stars;      /* 0: max_stars of the options */
    int32_t points_only;     /* 1: no streaks, wide stars or other shapes */
    int32_t narrow;          /* 1: the PSF sigma is that of the narrowest detections */
    int32_t reserved;
} st_search_options;

/* Bytes of what a searched image passes to the next ones: background and PSF sigma. The caller
 * stores it, aligned to 64 bytes, and may copy it. */
ST_API st_status st_searched_size(const st_tracker *tracker, size_t *bytes);

/* The stars of a whole image. streak is the motion during the exposure, null if unknown; before is
 * from a previous image, or null. *kept is 1 if after was filled. */
ST_API st_status st_search(st_tracker *tracker, const st_image *image,
                           const st_search_options *options, const st_streak *streak,
                           const void *before, void *after, int32_t *kept,
                           st_extraction *extraction);

/* The stars within radius_px (count) of places (count, 2), in an image of the size and type of the
 * one that filled before; null streak: points. */
ST_API st_status st_search_near(st_tracker *tracker, const st_image *image, const double *places,
                                const double *radius_px, size_t count, const st_streak *streak,
                                const void *before, void *after, st_extraction *extraction);

/* Connected bright areas of any shape, in st_centroids(). Each of 8 x 8 cells of the image has at
 * most cell_share times its share. calm 1: without those of trees, buildings and text. */
ST_API st_status st_find_spots(st_tracker *tracker, const st_image *image, double cell_share,
                               int32_t calm);

/* The peaks of an image with the largest ratio of height to noise, at most 30 and whatever the
 * threshold of the options, in st_centroids(). */
ST_API st_status st_find_highest_peaks(st_tracker *tracker, const st_image *image);

/* Position and PSF sigma (capacity, 3) in px of the stars at the highest peaks of the image that
 * filled searched, each fitted alone. */
ST_API st_status st_measure_widths(st_tracker *tracker, const st_image *image,
                                   const void *searched, double *widths, size_t capacity,
                                   size_t *count);

/* Saturation level of the image, infinity without saturated pixels. */
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

/* Pattern stars, brightest first, and their cells, as in a sky file; no pairs if candidates are
 * only verified. bright_image_stars and bright_triangles come first, in the bright pairs. */
typedef struct {
    const int32_t *hip;
    const double *direction, *magnitude;
    const uint8_t *blended;
    const int32_t *start, *member;
    st_pairs bright, pairs;
    double scale_error; /* relative, of the focal length, instead of fov_error_percent */
    int32_t stars, cells;
    int32_t bright_image_stars, bright_triangles;
    int32_t most_centroids;
    int32_t bases_by_brightness; /* 1: brightness chose the candidates and is not evidence */
    int32_t lens_unknown;        /* 1: the lens is fitted later, so near misses are allowed */
    int32_t in_cells;            /* stars that the cells have; the others are not looked for */
} st_patterns;

/* As st_size() and st_create(), for a tracker that identifies stars by these patterns. Other stages
 * need sky, a file that may have no patterns; otherwise null. */
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

/* The first usable centroids in an order (given), each star once: their index (count), direction
 * (count, 3) and sigma_rad (count) with the floor. count is the capacity on input, the number on
 * output. */
ST_API st_status st_usable_stars(const st_camera *camera, const st_centroid *centroids,
                                 const int32_t *order, size_t given, double sigma_floor_px,
                                 int32_t *index, double *direction, double *sigma_rad,
                                 size_t *count);

/* Support (count) by the other image stars for each candidate: base (3) are the pattern stars
 * candidates (count, 3). */
ST_API st_status st_support(st_tracker *tracker, const st_image_stars *stars, const int32_t *base,
                            const int32_t *candidates, size_t count, double *support);

/* Verify that image stars base (based) are the pattern stars pattern (based), after `tested`
 * candidates. star, residual_px and residual_rad (count) are those of each image star, -1 or NaN if
 * unmatched. */
ST_API st_status st_verify(st_tracker *tracker, const st_image_stars *stars, const int32_t *base,
                           const int32_t *pattern, size_t based, double tested,
                           st_verification *verification, int32_t *star, double *residual_px,
                           double *residual_rad);

/* The most probable candidate: image stars base (count, 4) are the pattern stars pattern (count,
 * 4). Candidates below least_support are not verified. best is -1 if all are rejected. */
ST_API st_status st_verify_quads(st_tracker *tracker, const st_image_stars *stars,
                                 const int32_t *base, const int32_t *pattern, size_t count,
                                 double least_support, double tested, int32_t *best,
                                 double *false_alarm_probability);

/* ---- the filter of single stars ------------------------------------------------------------- */

/* gate is a squared Mahalanobis distance, gate_probability that of a detected star inside it,
 * detection_probability that of a centroid for a star, image_px2 the image area. clutter_px2 is the
 * density of false centroids; 0: by association, an st_association. */
typedef struct {
    double gate, gate_probability, detection_probability, image_px2, clutter_px2;
    int32_t association, reserved;
} st_detection;

/* Bytes of memory, aligned to 64, of st_cycle() for at most so many tracks and centroids. */
ST_API st_status st_cycle_size(size_t tracks, size_t centroids, size_t *bytes);

/* One cycle of the filter of Sadeghi, Sabahi and Saberali, as in the tracker for constant_velocity
 * and coordinated_turn: prediction, JPDA, update. state (tracks, 4) is [u, u_rate, v, v_rate] in px
 * and px/s with covariance (tracks, 4, 4). transition and noise are (4, 4). Centroids are uv
 * (centroids, 2) with variance (centroids) in px^2 per axis. probability (tracks, centroids + 1),
 * or null, is filled; column 0 is that of a missed star. Input is finite, variances are positive,
 * covariances positive semidefinite. */
ST_API st_status st_cycle(void *memory, size_t bytes, const st_detection *detection,
                          const double transition[16], const double noise[16], double *state,
                          double *covariance, size_t tracks, const double *uv,
                          const double *variance, size_t centroids, double *probability);

/* ---- the stars of a single frame ------------------------------------------------------------ */

/* Apparent direction (count, 3) on ICRF axes, place uv (count, 2) and sigma_px (count) of each. */
typedef struct {
    const double *direction, *uv, *sigma_px;
    int32_t count, reserved;
} st_tracked_stars;

/* turn_rad is the rotation about sensor axes to the best fit, with its covariance. lens has the
 * normal equations of changes f of the focal ratio and k of k1, with the attitude eliminated: ff,
 * fk, kk, f, k. stars is 0 if fewer than four have a centroid. */
typedef struct {
    double turn_rad[3], covariance_rad2[3][3], lens[5];
    int32_t stars, reserved;
} st_frame_fit;

/* Fit the stars that have one of the centroids uv (centroids, 2) within 5 sigma, near an attitude.
 * star and centroid (fit->stars) are these pairs; residual (fit->stars, 2), in rad to the east and
 * north of each star, is from the fit of the others; sigma_rad is (fit->stars). The capacity of
 * each is stars->count. st_check_camera() must accept the camera. */
ST_API st_status st_fit_frame(const st_camera *camera, const double quaternion[4],
                              const st_tracked_stars *stars, const double *uv,
                              const double *sigma_px, size_t centroids, st_frame_fit *fit,
                              int32_t *star, int32_t *centroid, double *residual,
                              double *sigma_rad);

/* ---- orbits -------------------------------------------------------------------------------- */

/* Point mass and J2 of a body with the z axis as its pole, for an equatorial radius. */
typedef struct {
    double mu_m3_s2, radius_m, j2;
} st_gravity;

/* Propagate a state, position in m and velocity in m/s, by steps of step_s. */
ST_API void st_propagate_orbit(const st_gravity *gravity, double step_s, int32_t steps,
                               double state[6]);
/* ---- single attitudes ---------------------------------------------------------------------- */

/* Attitude by an st_solver from the directions sensor and icrf (count, 3), of any length, to the
 * same stars with errors sigma_rad (count). residual_rad (count) is the angle of each. Without an
 * attitude there is a reason. work has 512 bytes plus 64 per star. */
ST_API st_status st_fit_attitude(int32_t solver, const double *sensor, const double *icrf,
                                 const double *sigma_rad, size_t count, st_attitude *attitude,
                                 double *residual_rad, st_reason *reason, void *work,
                                 size_t bytes);

/* The protection level about sensor axes of an attitude of this covariance: docs/integrity.md. Rows
 * of stars (count, 5) are direction, sigma_rad and residual_rad. rejected is the number of rejected
 * stars. */
ST_API st_status st_protection_level(const double covariance_rad2[9], const double *stars,
                                     size_t count, double misleading_probability,
                                     double false_star_probability, int32_t rejected,
                                     double level_rad[3]);

/* ---- blind search of photographs ----------------------------------------------------------- */

/* The pairs i < j (found, 2) of stars direction (stars, 3) within a chord, and squared chords
 * (found). The stars are sorted by the cells of a cube with `cells` along each axis:
 * member[start[c]] to member[start[c + 1] - 1] are in cell c. found is the capacity on input, the
 * number on output. */
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

/* The quads of a table whose code matches one of quads (count, 4) of image stars within a
 * tolerance. The direction (stars, 3) of an image star may be NaN. The catalogue side is low to
 * high times the image side. image (found, 4) has image stars in the order of the code, row (found)
 * the rows of the table, ratio (found) those of the sides. found is the capacity on input, the
 * number on output. */
ST_API st_status st_match_quads(const st_quad_table *table, const double *direction, size_t stars,
                                const int32_t *quads, size_t count, double tolerance, double low,
                                double high, int32_t *image, int32_t *row, double *ratio,
                                size_t *found);

/* Stars direction (stars, 3) of a level in the order of their cells in a cube with `cells` along
 * each axis: start[c] to start[c + 1] - 1 are in cell c, and member (stars) is the rank of each by
 * brightness. Sides of quads are chords of side to longest; a star within crowd of a brighter one
 * is in none. */
typedef struct {
    const double *direction;
    const int32_t *start, *member;
    double side, longest, crowd;
    int32_t stars, cells, most_inner, reserved;
} st_quad_level;

/* The quads of a level, C and D two of the most_inner brightest stars between A and B: code and
 * ranks star (found, 4), side_rad (found). found is the capacity on input, the number on output; next is
 * 0 at first, and the number of stars when all quads are made: call again until then. Work memory
 * that stays between the calls: near, by_rank, square and alone (stars). */
ST_API st_status st_make_quads(const st_quad_level *level, int32_t *near, int64_t *by_rank,
                               double *square, uint8_t *alone, size_t *next, float *code,
                               int32_t *star, float *side_rad, size_t *found);

/* The cell (count) of each code (count, 4). */
ST_API st_status st_quad_cells(const float *code, size_t count, int32_t *cell);

/* The order (count) of things in cells cell (count), stable; those of cell c are order[start[c]] to
 * order[start[c + 1] - 1]. */
ST_API st_status st_sort_by_cell(const int32_t *cell, size_t count, int32_t cells, int32_t *start,
                                 int32_t *order);

/* Choose (stars) the first `most` stars of each cell of the sky, brightest first. The sky has bands
 * of equal height in declination; the cells of band b are first[b] to first[b + 1] - 1. filled has
 * a zero for each cell, chosen one for each star. */
ST_API st_status st_brightest_of_cells(const double *ra_rad, const double *dec_rad, size_t stars,
                                       const int32_t *first, int32_t bands, int32_t most,
                                       uint8_t *filled, uint8_t *chosen);

#define ST_TRIANGLE_CELLS 40 /* of codes of triangles along each axis */

/* Triangles of the sky, sorted by the cell of the code, then by the longest side: side_rad
 * (triangles, 3), longest first, and the opposite star (triangles, 3). Those of cell c are start[c]
 * to start[c + 1] - 1. neighbour (stars, neighbours) has the bright stars around each one, -1 if
 * fewer. low_rad to high_rad is the range of the longest side. No array is copied or checked. */
typedef struct {
    const float *side_rad;
    const int32_t *star, *start, *neighbour;
    double low_rad, high_rad;
    int32_t neighbours;
    int32_t reserved;
} st_triangle_table;

/* All triangles of the stars direction (stars, 3) whose sides connect partners: the fainter
 * partners of star s are start[s] to start[s + 1] - 1. Output: side_rad and star (found, 3), cell
 * (found) of the code. found is the capacity on input, the number on output. */
ST_API st_status st_make_triangles(const double *direction, size_t stars, const int32_t *partner,
                                   const int32_t *start, double shortest_rad,
                                   double least_longest_rad, double longest_rad, float *side_rad,
                                   int32_t *star, int32_t *cell, size_t *found);

/* The most probable triangle of image stars, or the first below false_alarm_max, for few stars
 * among many false detections; output as st_verify(). Work is the expected time on a processor of 3
 * GHz; *work_s beyond most_work_s: the search is incomplete. */
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

/* Support (count) by the other image stars that base (count, 4) are the catalogue stars star
 * (count, 4), exact only beyond `least`. */
ST_API st_status st_support_in_cells(const st_star_cells *sky, const st_image_stars *stars,
                                     double tolerance_sigmas, const int32_t *base,
                                     const int32_t *star, size_t count, double least,
                                     double *support);

#define ST_MOST_LENS_PARAMETERS 11

/* Start of a lens fit. free has the prior standard deviations of its parameters: rotation about
 * sensor axes (3) in rad, logarithms of focal length and pixel ratio, principal point (2) in image
 * widths, and the radial terms from k1 on: k2 to k4 of an equidistant model about those of the
 * projection sin(b theta) / b or tan(c theta) / c that has its k1. */
typedef struct {
    st_camera start;
    double free[ST_MOST_LENS_PARAMETERS];
    int32_t parameters; /* 8 .. 11 */
    int32_t reserved;
} st_lens_prior;

/* A lens fitted to one image, with the covariance of its parameters. */
typedef struct {
    st_camera camera;
    double quaternion[4]; /* q_icrf_from_sensor */
    double covariance[ST_MOST_LENS_PARAMETERS][ST_MOST_LENS_PARAMETERS];
    double error_px;    /* per axis, by the residuals */
    double probability; /* of st_grow_lens(): of its matches by chance */
    int32_t folds;      /* 1: it folds the image, or is not a lens */
    int32_t reserved;
} st_fitted_lens;

/* Unit vectors direction (stars, 3) in ICRF; places spot_px (spots, 2), sigma_px (spots). */
typedef struct {
    const double *direction, *spot_px, *sigma_px;
    int32_t stars, spots;
} st_sky_and_spots;

/* Fit a lens, starting at its camera and attitude, to detections of known stars: star (spots), -1
 * if unknown. This and the next two calls need work of 512 bytes plus 32 per detection. */
ST_API st_status st_fit_lens(const st_lens_prior *prior, const st_sky_and_spots *seen,
                             const int32_t *star, st_fitted_lens *lens, void *work, size_t bytes);

/* Match detections to stars one to one, within the gates of a fitted lens of so many parameters:
 * star (spots), -1 if unmatched. */
ST_API st_status st_gated_stars(const st_fitted_lens *lens, int32_t parameters, double error_px,
                                const st_sky_and_spots *seen, int32_t *star, void *work,
                                size_t bytes);

/* The most probable of the lenses grown from candidates: spots (count, 4) are the stars (count, 4),
 * with the focal length of the prior over ratio (count). */
ST_API st_status st_grow_lens(const st_lens_prior *prior, const st_sky_and_spots *seen,
                              const int32_t *spots, const int32_t *stars, const double *ratio,
                              size_t count, st_fitted_lens *lens, int32_t *star, void *work,
                              size_t bytes);

/* The stars direction (stars, 3) in the image of a camera at an attitude: index (count) and pixel
 * (count, 2), with a capacity for all. */
ST_API st_status st_stars_in_image(const st_camera *camera, const double quaternion[4],
                                   const double *direction, size_t stars, int32_t *index,
                                   double *pixel, size_t *count);

/* ---- checks of integrity: docs/integrity.md has their evidence and what follows ------------- */

#define ST_MOST_LIMITS 6

typedef struct {
    const char *name; /* with its unit */
    double value;
} st_limit;

/* The action follows if the evidence exceeds the threshold or the limits. */
typedef struct {
    const char *name;
    double probability; /* of the threshold by chance; 0: distribution not known */
    double threshold;   /* chi-square that is exceeded with it; 0 without dof */
    int32_t dof;
    int32_t frames; /* evaluated, in a row or the first ones; 0: a single frame */
    int32_t reason; /* st_reason_code; 0: another hypothesis, or a figure */
    int32_t limits;
    st_limit limit[ST_MOST_LIMITS];
} st_check;

/* All checks, constants of the library. */
ST_API const st_check *st_checks(size_t *count);

#ifdef __cplusplus
}
#endif

#endif /* STARTRACKER_GROUND_H */

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Inner functions of the core for tests: of libstartracker_test, which is built next to the
 * library and not installed, so that no code for tests flies. Matrices are by rows.
 */

#ifndef STARTRACKER_TEST_KERNELS_H
#define STARTRACKER_TEST_KERNELS_H

#include "startracker.h"

#ifdef __cplusplus
extern "C" {
#endif

ST_API void stt_multiply(const double a[4], const double b[4], double product[4]);
ST_API void stt_quaternion_from_rotation_vector(const double rotation[3], double q[4]);
ST_API void stt_rotation_vector_from_quaternion(const double q[4], double rotation[3]);
ST_API void stt_matrix_from_quaternion(const double q[4], double matrix[9]);
ST_API void stt_quaternion_from_matrix(const double matrix[9], double q[4]);
ST_API void stt_turned(const double q[4], const double rotation[3], double after[4]);
ST_API void stt_turn_matrix(const double matrix[9], const double g[3], double after[9]);
ST_API void stt_attitude_error(const double estimate[4], const double truth[4], double error[3]);
ST_API void stt_quaternion_from_axes(const double z[3], const double towards_y[3], double q[4]);
ST_API void stt_covariance_icrf(const double q[4], const double sensor[9], double icrf[9]);
ST_API void stt_matrix_from_rotation_vector(const double rotation[3], double matrix[9]);
ST_API void stt_sign_continuous(const double q[4], const double previous[4], double continuous[4]);
ST_API void stt_sensor_direction(const double matrix[9], const double icrf[3], double sensor[3]);
ST_API double stt_angle_between(const double a[3], const double b[3]);

/* size is 3, 6 or 9; the first two are of the upper left 3 x 3 block. */
ST_API double stt_determinant(int32_t size, const double *symmetric);
ST_API void stt_inverse(int32_t size, const double *symmetric, double inverse[9]);
ST_API int32_t stt_is_positive_definite(int32_t size, const double *symmetric);
/* The lower triangle, and the solution (size, 2) of symmetric x = right; 0 if not positive. */
ST_API int32_t stt_cholesky(int32_t size, const double *symmetric, const double *right,
                            double *lower, double *solution);

ST_API double stt_gate(double probability, double dof);

ST_API double stt_corner_angle(const st_camera *camera);
ST_API int32_t stt_shows(const st_camera *camera, const double pixel[2]);
ST_API void stt_middle_axes(const st_camera *camera, double q[4]);

/* Of a sky file that st_check_sky has found sound. */
ST_API int32_t stt_stars_in_cone(const st_sky *file, const double axis[3], double radius_rad,
                                 int32_t *index, int32_t capacity);
ST_API int32_t stt_nearest_star(const st_sky *file, const double direction[3], double chord,
                                double *square);
ST_API void stt_direction_at(const st_sky *file, int32_t star, double years,
                             const double moved_au[3], double direction[3]);
ST_API void stt_pairs_between(const st_sky *file, int32_t bright, double low_rad, double high_rad,
                              int32_t range[2]);

/* ---- fits of stars ------------------------------------------------------------------------- */

/* An image with its background; peak (peaks, 7) is u, v, top_u, top_v, height, level, noise. */
typedef struct {
    const uint16_t *pixel; /* rows without gaps */
    const double *level, *noise;
    const double *peak;
    double median_level, median_noise, tiles_down, tiles_across;
    double filter_sigma_px, full_scale_dn;
    int32_t width, height, tile_rows, tile_columns, peaks;
    int32_t reserved;
} stt_frame;

/* Windows (count, side, side) with corner (count, 2), variance (count), and their fits. */
typedef struct {
    int32_t count, side, free, iterations; /* free is 4 or 5 */
    double gain_dn, model_error;
    float *data, *used;
    int32_t *corner;
    double *variance;
    double *star;                /* (count, 5): start, then result */
    double *covariance;          /* (count, free, free) */
    double *chi2, *dof;          /* (count) */
    float *model, *own, *weight; /* (count, side, side) */
    double *shape;               /* (count, 6): straight, oblique, size, variance, narrow, wide */
    double *noise;               /* (2): gain and model error by the residuals, of free == 4 */
} stt_windows;

/* a, da/du and da/dsigma (3, count). */
ST_API void stt_profile(double centre, double sigma, int32_t first, int32_t count,
                        double *profile);
ST_API void stt_cut_windows(const stt_frame *frame, double sigma_px, stt_windows *windows);
ST_API void stt_fit_windows(stt_windows *windows);

/* Segmentation is threshold_dn, iterative, factor. Counts are capacities, then how many there are.
 * Returns whether all are smeared. */
ST_API int32_t stt_measure_points(const stt_frame *frame, double sigma_px, int32_t method,
                                  const double segmentation[3], double threshold_sigmas,
                                  int32_t most, st_centroid *stars, int32_t *count,
                                  st_rejected *rejected, int32_t *rejected_count);
/* Returns whether it is certain. */
ST_API int32_t stt_psf_sigma(const stt_frame *frame, int32_t narrow, double *sigma_px);

/* Streaks star (count, 7), covariance (count, free, free) for free 4 or 7; sky (count, 4) is level,
 * slopes across and down, variance. */
ST_API void stt_fit_streaks(const stt_frame *frame, const double *sky, double *star,
                            double *covariance, double *chi2, double *dof, int32_t count,
                            int32_t free, double gain_dn, int32_t iterations);
/* By the same fits with 4 parameters free. */
ST_API double stt_photon_gain(const stt_frame *frame, const double *sky, const double *star,
                              int32_t count, double gain_dn);
ST_API double stt_streak_flux(const stt_frame *frame, const double sky[4], const double star[7]);
ST_API double stt_streak_share(const double star[7], double x, double y);
/* A streak is u_px, v_px, roll, u0, v0. */
ST_API void stt_fit_streak(const double *places, const double *streaks, const double *weight,
                           int32_t count, int32_t width, int32_t height, double streak[5]);
ST_API void stt_joined(const double one[5], const double other[5], double joined[5]);
/* Returns whether one was found. */
ST_API int32_t stt_estimate_streak(const stt_frame *frame, double start_px, double streak[5],
                                   double *sigma_px);
/* places (1000, 2); returns how many there are. */
ST_API int32_t stt_search_streaks(const stt_frame *frame, const double streak[5], double sigma_px,
                                  double threshold_sigmas, double *places);
ST_API void stt_measure_streaks(const stt_frame *frame, const double *places, int32_t places_count,
                                const double streak[5], double sigma_px, double threshold_sigmas,
                                st_centroid *stars, int32_t *count, st_rejected *rejected,
                                int32_t *rejected_count);
ST_API void stt_pointing_error(const stt_frame *frame, const double *star, int32_t count,
                               int32_t streaked, double covariance[4]);

/* ---- steps of a search --------------------------------------------------------------------- */

/* An image (height, width) after the filter of a PSF sigma: by rows as in a search, and pixel by
 * pixel; and the gain of its noise. */
ST_API void stt_filter(const uint16_t *image, int32_t width, int32_t height, double sigma_px,
                       double *by_rows, double *by_pixels, double *noise_gain);
/* Numbers the spots of a mask (height, width), from 1 on; returns how many there are. */
ST_API int32_t stt_connect(int32_t *mask, int32_t width, int32_t height);
/* The pixels places (count, 2), with levels and noise, that are sharper than a star: hit (count). */
ST_API void stt_hits(const uint16_t *image, int32_t width, int32_t height, const double *places,
                     int32_t count, double level_dn, double noise_dn, double sigma_px,
                     double *hit);
/* chosen (count) is 1 for places (count, 2) that are. */
ST_API void stt_choose(const double *places, int32_t count, int32_t width, int32_t height,
                       int32_t most, double cell_share, double *chosen);
/* Exposure and its limits after images that show one, each shown (count, 2) with a weight. */
ST_API void stt_exposure(double given_s, const double *shown, int32_t count, double exposure[3]);

#ifdef __cplusplus
}
#endif

#endif

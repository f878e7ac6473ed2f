// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Association, stars in view, starts and the models of stars for tests, as kernels.h has others.
 * Matrices are by rows, lists come with their capacity; masks and indices are int32.
 */

#ifndef STARTRACKER_TEST_KERNELS_BANK_H
#define STARTRACKER_TEST_KERNELS_BANK_H

#include "startracker.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- association --------------------------------------------------------------------------- */

/* weight (tracks, columns) becomes probabilities; left_out (2) counts pairings and states. Returns
 * the logarithm of the sum over all events. */
ST_API double stt_marginalise(double *weight, int32_t tracks, int32_t columns, int32_t max_steps,
                              int32_t *left_out);
/* predicted, uv (count, 2), covariances (count, 3) uu uv vv; detection is gate, gate probability,
 * detection probability, px^2. factor is an st_association, -1 that of the attitude model. confirmed
 * (tracks) may be null. probability (tracks, centroids + 1), unassociated (centroids). */
ST_API void stt_associate(const double *predicted, const double *covariance, int32_t tracks,
                          const double *uv, const double *error, int32_t centroids,
                          const double detection[4], int32_t factor, const int32_t *confirmed,
                          double *probability, int32_t *unassociated, int32_t *left_out);
/* state (tracks, 4) and covariance (tracks, 4, 4) are updated; 0 centroids cannot be. */
ST_API void stt_update(const double *probability, int32_t tracks, const double *uv,
                       const double *variance, int32_t centroids, double *state,
                       double *covariance);
ST_API void stt_predict(const double transition[16], const double noise[16], int32_t tracks,
                        double *state, double *covariance);

/* ---- motion -------------------------------------------------------------------------------- */

ST_API void stt_star_motion(int32_t model, double dt_s, double rate_rad_s, const double noise[2],
                            double transition[16], double covariance[16]);
ST_API void stt_rolled(const st_camera *camera, double rate_rad_s, double dt_s,
                       double transition[16]);
ST_API void stt_turn_curvature(const st_camera *camera, const double *uv, int32_t count,
                               const double rate[3], double dt_s, double *curvature);
ST_API void stt_moved_by(const st_camera *camera, const double *uv, const double *variance,
                         int32_t count, const double rate[3], const double rate_covariance[9],
                         double *state, double *covariance);
ST_API void stt_propagated(const st_camera *camera, const double *uv, int32_t count,
                           const double rate[3], double dt_s, double *moved);
/* covariance (count, 3) is that of the velocities (count, 2) of stars at uv. */
ST_API int32_t stt_body_rate(const st_camera *camera, const double *uv, const double *velocity,
                             const double *covariance, int32_t count, double rate[3],
                             double rate_covariance[9]);
ST_API int32_t stt_rate_between_frames(const st_camera *camera, const st_centroid *before,
                                       int32_t before_count, const st_centroid *after,
                                       int32_t after_count, double dt_s, double rate[3]);
ST_API void stt_star_neighbourhood(const st_camera *camera, const double *predicted,
                                   const double *icrf, int32_t stars, const double *uv,
                                   const double *sigma_px, int32_t centroids, int32_t *assigned);

/* ---- sky ----------------------------------------------------------------------------------- */

ST_API void stt_apparent(const st_observer *observer, const double *natural, int32_t count,
                         double *apparent);

/* The sky and the stars in view that the functions below are about: one at a time. Returns whether
 * the file has all that is needed. */
ST_API int32_t stt_open_view(const st_sky *file, const st_camera *camera, double years,
                             const double moved_au[3]);
ST_API void stt_add_observer(const int64_t *stamp_ns, const st_observer *observer);
/* Returns a number that changes when directions do; sigma (2) is that of velocity m/s and years. */
ST_API int32_t stt_look(const int64_t *stamp_ns, double sigma[2]);
ST_API void stt_sky_stars(const int32_t *star, int32_t count, double *direction, int32_t *crowded);
ST_API int32_t stt_star_of_hip(int32_t hip);

/* Lists have star (capacity), sensor (capacity, 3), uv (capacity, 2). All return a count. */
ST_API int32_t stt_stars_in_view(const double q[4], int32_t capacity, int32_t *star,
                                 double *sensor, double *uv);
ST_API int32_t stt_stars_beside(const double q[4], const double *pixel, int32_t count,
                                double reach_px, int32_t capacity, int32_t *star, double *sensor,
                                double *uv);
ST_API int32_t stt_unexplained(const double q[4], const st_centroid *centroids, int32_t count,
                               double reach_px, double reach_sigmas, int32_t *left);
/* visible (capacity, 4) is pixel and velocity. */
ST_API int32_t stt_visible_stars(const double q[4], const double rate[3], double faintest,
                                 int32_t capacity, double *visible);
ST_API int32_t stt_predict_stars(const double q[4], const double covariance[9],
                                 const double rate[3], double faintest, int32_t capacity,
                                 st_prediction *predicted);
/* free (count, 4) is pixel, flux, sigma; found (capacity, 2) is star and row of free. */
ST_API int32_t stt_new_stars(const double q[4], const double covariance[9], const double *free,
                             int32_t count, double zero_point, double magnitude_tolerance,
                             int32_t capacity, int32_t *found);

/* ---- fits and starts ----------------------------------------------------------------------- */

/* Attitude is q, covariance (9); figures are scale, rms px, chi2, stars. Returns whether there is
 * one. */
ST_API int32_t stt_fit_rotation(const st_camera *camera, const double *icrf, const double *uv,
                                const double *sigma_px, const int32_t *candidate, int32_t count,
                                int32_t solver, double attitude[13], double figures[4],
                                double *normalised, int32_t *inlier);
/* star and centroid (count) of those that fit, of the sky of stt_open_view; returns how many. */
ST_API int32_t stt_fit_identified(const st_tracking_options *options, const st_centroid *centroids,
                                  const int32_t *hip, int32_t count, int32_t *star,
                                  st_centroid *centroid, double attitude[13], double *scale,
                                  st_reason *reason);
/* Whether a tracked attitude contradicts the frame of the last stt_fit_identified. */
ST_API int32_t stt_contradicts(const double q[4], const double covariance[9],
                               double max_residual_px);
/* Frames are hints without rates, with a scale; rates is rate 3, its covariance 9, cross 9. */
ST_API void stt_start_of_two(const st_hint *first, double first_scale, const st_hint *second,
                             double second_scale, double rates[21]);
/* hinted 1: a hint from elsewhere, which is forgotten afterwards; 0: a prediction of the tracks. */
ST_API int32_t stt_start_of_hint(const st_hint *hint, const st_hint *frame, double scale,
                                 double max_gap_s, int32_t hinted, double rates[21]);

/* ---- models of stars ----------------------------------------------------------------------- */

/* The model of options, at an attitude with its rate; roll is whether there is one, rad/s, and its
 * noise density. Of the sky of stt_open_view. */
ST_API void stt_open_model(const st_tracking_options *options, const st_hint *start,
                           const double roll[3]);
ST_API int32_t stt_add_star(const st_tracking_options *options, int32_t star,
                            const st_centroid *centroid, int32_t confirmed);
/* Both (tracks): which are kept, and which are confirmed. */
ST_API void stt_select_tracks(const int32_t *kept, const int32_t *confirmed);
/* track (tracks, 30): state 4, covariance 16, variance, flux, snr, sigma, residual, probability,
 * star, age, missed, confirmed. attitude and figures as of stt_fit_rotation, rates as above without
 * cross; unassociated (count); flags are good, has_fit, uses_gyro, code of gyro_trouble, tracks. */
ST_API void stt_update_model(const st_tracking_options *options, const int64_t *stamp_ns,
                             const st_centroid *centroids, int32_t count, const double roll[3],
                             double *track, double attitude[13], double figures[4],
                             double rates[12], double *normalised, double *uv,
                             int32_t *unassociated, int32_t flags[5]);
/* The tracks of the model for publication; returns how many. */
ST_API int32_t stt_publish(int32_t identified, int32_t capacity, st_star_track *tracks);
/* The magnitude of 1 DN by its detected stars. */
ST_API void stt_zero_point(double *magnitude);
/* Which of its tracks are kept (tracks) while crowded or missed, and are confirmed afterwards. */
ST_API void stt_keep(const int32_t *crowded, double most_missed, int32_t confirm_frames,
                     int32_t *kept, int32_t *confirmed);
/* Rows (tracks, 16) of its detected stars: track, uv 2, residual 2, error 3, flow 6, velocity 2. */
ST_API int32_t stt_detected_stars(const double q[4], const double rate[3], const double *icrf,
                                  const double *distance, const int32_t *best, const double *uv,
                                  const double *error, int32_t centroids, double *detected);

#ifdef __cplusplus
}
#endif

#endif

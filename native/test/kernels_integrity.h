// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Solvers of the attitude and checks of integrity for tests, as kernels.h. Functions with a reason
 * return its code and fill in its figures (9). Directions, and pixels, are by rows; a covariance in
 * the image is uu, uv, vv.
 */

#ifndef STARTRACKER_TEST_KERNELS_INTEGRITY_H
#define STARTRACKER_TEST_KERNELS_INTEGRITY_H

#include "startracker.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How many sigma a normal value exceeds, up or down, with a probability. */
ST_API double stt_two_sided_sigmas(double probability);

/* ---- attitude ------------------------------------------------------------------------------ */

/* solution is the quaternion (4), the covariance (9) and chi2; residual_rad (count). */
ST_API int32_t stt_solve(int32_t solver, const double *sensor, const double *icrf,
                         const double *sigma_rad, int32_t count, double *figure, double *solution,
                         double *residual_rad);
/* Weights sum to 1; returns the gap. */
ST_API double stt_best_rotation(int32_t solver, const double *sensor, const double *icrf,
                                const double *weight, const double *sigma_rad, int32_t count,
                                double *matrix);
ST_API void stt_triad(const double *sensor, const double *icrf, int32_t count, int32_t first,
                      int32_t second, double *matrix);
/* Returns the determinant. */
ST_API double stt_refine(const double *sensor, const double *icrf, const double *weight,
                         int32_t count, int32_t most_steps, double *matrix, double *covariance);
ST_API double stt_cramer_rao(const double *sensor, const double *sigma_rad, int32_t count,
                             double *covariance);
ST_API double stt_mean_chi2(const double *solution, const double *icrf, const double *sigma_rad,
                            int32_t count);
/* solution and residual_rad as of stt_solve, changed in place; error (count, 3). */
ST_API void stt_fit_error_ellipses(const st_camera *camera, const double *uv, const double *error,
                                   const double *icrf, int32_t count, double *solution,
                                   double *residual_rad);
/* rate may be null. */
ST_API void stt_pointing_covariance(const st_camera *camera, const double *common,
                                    const double *rate_rad_s, double *covariance);
ST_API void stt_covariance_of(const st_budget *budget, double *covariance);

/* ---- integrity ----------------------------------------------------------------------------- */

/* Bytes of what is known of the lens and of the stamps. */
ST_API void stt_integrity_sizes(int32_t *bytes);

/* star (count, 15) is u, v, residual 2, error 3, flow 6, velocity 2; pattern (38) is product and
 * energy of 13, edge of 12. Returns chi2. */
ST_API double stt_fit_rows(const st_camera *camera, const double *star, int32_t count,
                           double *pattern);
/* memory (4), changed in place, is product, energy, excess, frames. */
ST_API int32_t stt_find_pattern(const st_camera *camera, const double *star, int32_t count,
                                double *memory, double *figure);
/* expected (count, 4) is u, v, velocity 2; uv (centroids, 2). */
ST_API int32_t stt_contradiction(const double *expected, int32_t count, const double *uv,
                                 int32_t centroids, double present_px, double *figure);

/* memory of so many bytes, zero at the start, is changed in place; known is value_px, scale,
 * scale_sigma. Returns whether there is a scale for the first time. */
ST_API int32_t stt_add_to_lens_error(const st_camera *camera, const int32_t *index,
                                     const double *star, int32_t count, void *memory,
                                     double *known);

/* States are quaternion 4 and rate 3; known is sigma_s and turn_rad. */
ST_API void stt_start_jitter(void *memory);
ST_API void stt_interrupt_jitter(void *memory);
ST_API void stt_add_to_jitter(int64_t before_ns, int64_t stamp_ns, const double *before,
                              const double *predicted, const double *corrected, const double *turn,
                              const double *covariance, void *memory, double *known);

/* Rates (rates, 3) of a gyro of these options (4), and frames (frames, 25): quaternion, covariance,
 * drift, its covariance. found (frames, 2) is whether the gyro contradicts, and frames that agreed. */
ST_API void stt_compare_gyro(const double *options, const int64_t *rate_ns, const double *rate,
                             int32_t rates, const int64_t *frame_ns, const double *frame,
                             int32_t frames, int32_t *found);

/* star (count, 5) is a direction, sigma_rad, residual_rad; probabilities of misleading and false. */
ST_API void stt_protection_level(const double *covariance, const double *star, int32_t count,
                                 const double *probabilities, int32_t rejected, double *level);
ST_API int32_t stt_is_covariance(const double *matrix);

ST_API void stt_velocity_covariance(double sigma_m_s, const double *sensor,
                                    const double *sigma_rad, int32_t count, double *covariance);
ST_API void stt_lens_covariance(double lens_sigma_rad, double scale, const double *sensor,
                                const double *sigma_rad, int32_t count, double *covariance);
/* motion (count, 3), or null. */
ST_API void stt_epoch_covariance(const double *quaternion, double sigma_years,
                                 const double *sensor, const double *sigma_rad,
                                 const double *motion, int32_t count, double *covariance);

/* star (count, 11) is u, v, error 3, direction 3, motion 3; previous is the quaternion before, null
 * for none. trusted (18) is quaternion, covariance, chi2, residual_px, protection. */
ST_API int32_t stt_trust_stars(const st_camera *camera, const st_trust_options *options,
                               const double *star, int32_t count, double velocity_sigma_m_s,
                               double epoch_sigma_years, const double *previous, double *figure,
                               double *trusted);
/* star (count, 7) is u, v, direction 3, sigma_px, residual_px. */
ST_API int32_t stt_trust_tracks(const st_camera *camera, const st_trust_options *options,
                                const double *quaternion, const double *covariance, double chi2,
                                const double *star, int32_t count, const double *previous,
                                double *figure, double *trusted);

#ifdef __cplusplus
}
#endif

#endif /* STARTRACKER_TEST_KERNELS_INTEGRITY_H */

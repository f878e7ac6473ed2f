// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* The filter of attitude and motion for tests, as kernels.h. Matrices are by rows. */

#ifndef STARTRACKER_TEST_KERNELS_FILTER_H
#define STARTRACKER_TEST_KERNELS_FILTER_H

#include "startracker.h"

#ifdef __cplusplus
extern "C" {
#endif

/* covariance (9 + K, 9 + K). */
typedef struct {
    int64_t stamp_ns;
    double quaternion[4], rate[3], drift[3];
    double *covariance;
} stt_state;

/* mean (9, 12 + K), covariance (9, 12 + K, 12 + K) of K constants. swing: last 4, turn, change and
 * older 3 each, product, energy, w2, weight, centre 3. wide 1: the filter of several heads. */
typedef struct {
    int64_t stamp_ns;
    int32_t constants, wide;
    double quaternion[4], weight[9], share[9], noise[3], interval_s, frames, swing[20];
    double jumps[3], seen_jumps;
    double *mean, *covariance;
} stt_motion;

/* Functions of a motion replace it by the result. */
ST_API void stt_start_motion(stt_motion *motion, const stt_state *state, const double *constants,
                             const double noise[3], double interval_s);
ST_API void stt_restart_motion(stt_motion *motion, const stt_state *state);
ST_API void stt_resume_motion(stt_motion *motion, const stt_motion *known);
ST_API void stt_interrupt_motion(stt_motion *motion);
/* dt_s (count + 1), rates (count, 3), variance (count), walk (3 + K). */
ST_API void stt_predict_motion(stt_motion *motion, int64_t to_ns, int32_t count,
                               const double *dt_s, const double *rates, const double *variance,
                               const double acceleration[3], const double *walk);
/* information (size, size), vector (size), beside (size, 6 + K), moved (size). */
ST_API void stt_update_motion(stt_motion *motion, const double quaternion[4], const double rate[3],
                              int32_t size, const double *information, const double *vector,
                              const double *beside, const double *moved);
ST_API void stt_measure_motion(stt_motion *motion, int64_t before_ns, const double quaternion[4],
                               const double R[9]);
ST_API void stt_state_of(const stt_motion *motion, const double weight[9], stt_state *state,
                         double *constants);
ST_API void stt_acceleration_of(const stt_motion *motion, double acceleration[3]);
ST_API void stt_with_tails(const stt_motion *motion, double covariance[36]);
ST_API void stt_vibration_covariance(const stt_motion *motion, double covariance[36]);
/* acceleration, sigma, jerk, sigma before. */
ST_API void stt_course_of(const stt_motion *motion, const double acceleration[3],
                          double course[12]);
ST_API void stt_by_experience(const double weight[9], const double share[9], double seen[9]);
ST_API double stt_tail_sigmas(double probability, double missed);
ST_API void stt_covariance_deficit(const double covariance[9], const double error[3],
                                   double across, double probability, double deficit[9]);

/* The state of a single tracker; information (size, size), vector (size). */
ST_API void stt_with_measured(stt_state *state, int32_t size, const double *information,
                              const double *vector);
ST_API void stt_with_new_drift(stt_state *state, double sigma_rad_s);

/* A gyro to which count rates (count, 3) of these stamps were added. */
typedef struct {
    const st_gyro_options *options;
    const int64_t *stamp_ns;
    const double *rates;
    int32_t count, capacity;
} stt_gyro;

ST_API void stt_gyro_model(const stt_gyro *gyro, double model[5]);
ST_API int32_t stt_gyro_count(const stt_gyro *gyro);
ST_API double stt_gyro_silent_s(const stt_gyro *gyro, int64_t stamp_ns);
ST_API int32_t stt_gyro_is_saturated(const stt_gyro *gyro, int64_t stamp_ns, double for_s);
/* Of so many constants. */
ST_API void stt_gyro_propagate(const stt_gyro *gyro, int32_t constants, stt_state *state,
                               int64_t to_ns);
ST_API void stt_gyro_predict(const stt_gyro *gyro, stt_state *state, int64_t to_ns,
                             stt_state *predicted);
/* dt_s (5), rates (4, 3), variance (4); returns the number of rates. */
ST_API int32_t stt_gyro_rates(const stt_gyro *gyro, int64_t from_ns, int64_t to_ns, double *dt_s,
                              double *rates, double *variance);
ST_API void stt_gyro_mean_rate(const stt_gyro *gyro, int64_t from_ns, int64_t to_ns,
                               double rate_and_variance[4]);

/* Lists of the stars in the image (stars each), probability (stars, centroids + 1), unassociated
 * (centroids); information (size, size), by_acceleration (size, 3) are by rows of 6 and 3. */
typedef struct {
    int32_t agreed, count, stars, inliers, size, reserved;
    int32_t *star, *best, *inlier, *unassociated;
    double *predicted, *probability, *distance_px, *normalised;
    stt_state state;
    double information[36], vector[6], by_acceleration[18], turn[3], turn_covariance[9];
    double innovation[3], residual_px, chi2, typical, precise;
} stt_correction;

/* centroid (centroids, 6): u, v, uu, uv, vv, delay; detection: gate and its probability, that of a
 * detection, area. */
ST_API void stt_correct(const st_camera *camera, const double *icrf, const int32_t *usable,
                        int32_t stars, int32_t min_stars, double outlier_sigmas,
                        const stt_state *predicted, const double *centroid, int32_t centroids,
                        const double detection[4], stt_correction *correction);
/* states (count, 4), covariances (count, 4, 4). */
ST_API void stt_on_image(const st_camera *camera, const double *icrf, int32_t count,
                         const stt_state *state, double *states, double *covariances);

ST_API void stt_at_frame_time(const st_camera *camera, const double *uv, const double *delay_s,
                              int32_t count, const double rate[3], const double acceleration[3],
                              double *moved);
/* Returns whether there is a rate. */
ST_API int32_t stt_fit_rate(const st_camera *camera, const double *icrf, const double *uv,
                            const double *sigma_px, const double *delay_s, int32_t count,
                            const double quaternion[4], double rate[3]);

#ifdef __cplusplus
}
#endif

#endif

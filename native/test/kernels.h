// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Inner functions of the core for tests: of libstartracker_test, which is built beside the library
 * and not installed, so that no code for tests flies. Matrices are by rows.
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

#ifdef __cplusplus
}
#endif

#endif

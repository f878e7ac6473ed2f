// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "kernels.h"

#include <cstring>

#include "camera/lens.h"
#include "maths/gates.h"
#include "maths/rotation.h"
#include "maths/symmetric.h"

using namespace st;

namespace {

/// Return a value of plain numbers out of an array, and into one.
template <class T>
T from(const double *numbers) {
    T value;
    std::memcpy(&value, numbers, sizeof(T));
    return value;
}

template <class T>
void into(double *numbers, const T &value) {
    std::memcpy(numbers, &value, sizeof(T));
}

template <int N>
int32_t factored(const double *symmetric, const double *right, double *lower, double *solution) {
    Matrix<N, N> L;
    if (!cholesky(from<Matrix<N, N>>(symmetric), L)) {
        return 0;
    }
    into(lower, L);
    into(solution, solved(L, from<Matrix<N, 2>>(right)));
    return 1;
}

/// Return a function of the upper left 3 x 3 block.
template <class Function>
auto of_size(int32_t size, const double *symmetric, Function function) {
    if (size == 3) {
        return function(from<Matrix<3, 3>>(symmetric));
    }
    return size == 6 ? function(from<Matrix<6, 6>>(symmetric))
                     : function(from<Matrix<9, 9>>(symmetric));
}

}  // namespace

extern "C" {

void stt_multiply(const double a[4], const double b[4], double product[4]) {
    into(product, multiply(from<Quaternion>(a), from<Quaternion>(b)));
}

void stt_quaternion_from_rotation_vector(const double rotation[3], double q[4]) {
    into(q, quaternion_from_rotation_vector(from<Vector3>(rotation)));
}

void stt_rotation_vector_from_quaternion(const double q[4], double rotation[3]) {
    into(rotation, rotation_vector_from_quaternion(from<Quaternion>(q)));
}

void stt_matrix_from_quaternion(const double q[4], double matrix[9]) {
    into(matrix, matrix_from_quaternion(from<Quaternion>(q)));
}

void stt_quaternion_from_matrix(const double matrix[9], double q[4]) {
    into(q, quaternion_from_matrix(from<Matrix3>(matrix)));
}

void stt_turned(const double q[4], const double rotation[3], double after[4]) {
    into(after, turned(from<Quaternion>(q), from<Vector3>(rotation)));
}

void stt_turn_matrix(const double matrix[9], const double g[3], double after[9]) {
    into(after, turn_matrix(from<Matrix3>(matrix), from<Vector3>(g)));
}

void stt_attitude_error(const double estimate[4], const double truth[4], double error[3]) {
    into(error, attitude_error(from<Quaternion>(estimate), from<Quaternion>(truth)));
}

void stt_quaternion_from_axes(const double z[3], const double towards_y[3], double q[4]) {
    into(q, quaternion_from_axes(from<Vector3>(z), from<Vector3>(towards_y)));
}

void stt_covariance_icrf(const double q[4], const double sensor[9], double icrf[9]) {
    into(icrf, covariance_icrf(from<Quaternion>(q), from<Matrix3>(sensor)));
}

void stt_matrix_from_rotation_vector(const double rotation[3], double matrix[9]) {
    into(matrix, matrix_from_rotation_vector(from<Vector3>(rotation)));
}

void stt_sign_continuous(const double q[4], const double previous[4], double continuous[4]) {
    into(continuous, sign_continuous(from<Quaternion>(q), from<Quaternion>(previous)));
}

void stt_sensor_direction(const double matrix[9], const double icrf[3], double sensor[3]) {
    into(sensor, sensor_direction(from<Matrix3>(matrix), from<Vector3>(icrf)));
}

double stt_angle_between(const double a[3], const double b[3]) {
    return angle_between(from<Vector3>(a), from<Vector3>(b));
}

double stt_determinant(int32_t size, const double *symmetric) {
    return of_size(size, symmetric, [](const auto &A) { return determinant(A); });
}

void stt_inverse(int32_t size, const double *symmetric, double inverse[9]) {
    into(inverse, of_size(size, symmetric, [](const auto &A) { return st::inverse(A); }));
}

int32_t stt_is_positive_definite(int32_t size, const double *symmetric) {
    return of_size(size, symmetric, [](const auto &A) { return is_positive_definite(A); }) ? 1 : 0;
}

int32_t stt_cholesky(int32_t size, const double *symmetric, const double *right, double *lower,
                     double *solution) {
    if (size == 3) {
        return factored<3>(symmetric, right, lower, solution);
    }
    return size == 6 ? factored<6>(symmetric, right, lower, solution)
                     : factored<9>(symmetric, right, lower, solution);
}

double stt_gate(double probability, double dof) {
    return gate(probability, dof);
}

double stt_corner_angle(const st_camera *camera) {
    return corner_angle(lens_of(*camera));
}

int32_t stt_shows(const st_camera *camera, const double pixel[2]) {
    return shows(lens_of(*camera), from<Point>(pixel)) ? 1 : 0;
}

void stt_middle_axes(const st_camera *camera, double q[4]) {
    into(q, middle_axes(lens_of(*camera)));
}

}  // extern "C"

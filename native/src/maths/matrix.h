// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Matrices of fixed size by rows, without a heap.

#pragma once

#include <cmath>

namespace st {

template <int R, int C>
struct Matrix {
    double row[R][C];

    double *operator[](int i) { return row[i]; }
    const double *operator[](int i) const { return row[i]; }
};

template <int N>
struct Vector {
    double element[N];

    double &operator[](int i) { return element[i]; }
    const double &operator[](int i) const { return element[i]; }
};

using Vector3 = Vector<3>;
using Matrix3 = Matrix<3, 3>;

template <int N>
Matrix<N, N> identity() {
    Matrix<N, N> I{};
    for (int i = 0; i < N; ++i) {
        I[i][i] = 1.0;
    }
    return I;
}

template <int R, int K, int C>
Matrix<R, C> operator*(const Matrix<R, K> &A, const Matrix<K, C> &B) {
    Matrix<R, C> product{};
    for (int i = 0; i < R; ++i) {
        for (int k = 0; k < K; ++k) {
            for (int j = 0; j < C; ++j) {
                product[i][j] += A[i][k] * B[k][j];
            }
        }
    }
    return product;
}

template <int R, int C>
Vector<R> operator*(const Matrix<R, C> &A, const Vector<C> &v) {
    Vector<R> product{};
    for (int i = 0; i < R; ++i) {
        for (int j = 0; j < C; ++j) {
            product[i] += A[i][j] * v[j];
        }
    }
    return product;
}

template <int R, int C>
Matrix<R, C> operator+(const Matrix<R, C> &A, const Matrix<R, C> &B) {
    Matrix<R, C> sum;
    for (int i = 0; i < R; ++i) {
        for (int j = 0; j < C; ++j) {
            sum[i][j] = A[i][j] + B[i][j];
        }
    }
    return sum;
}

template <int R, int C>
Matrix<R, C> operator-(const Matrix<R, C> &A, const Matrix<R, C> &B) {
    Matrix<R, C> difference;
    for (int i = 0; i < R; ++i) {
        for (int j = 0; j < C; ++j) {
            difference[i][j] = A[i][j] - B[i][j];
        }
    }
    return difference;
}

template <int R, int C>
Matrix<C, R> transposed(const Matrix<R, C> &A) {
    Matrix<C, R> T;
    for (int i = 0; i < R; ++i) {
        for (int j = 0; j < C; ++j) {
            T[j][i] = A[i][j];
        }
    }
    return T;
}

template <int N>
double dot(const Vector<N> &a, const Vector<N> &b) {
    double sum = 0.0;
    for (int i = 0; i < N; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

template <int N>
double norm(const Vector<N> &v) {
    return std::sqrt(dot(v, v));
}

template <int N>
Vector<N> scaled(const Vector<N> &v, double factor) {
    Vector<N> product;
    for (int i = 0; i < N; ++i) {
        product[i] = factor * v[i];
    }
    return product;
}

/// Return a x b.
inline Vector3 cross(const Vector3 &a, const Vector3 &b) {
    return {{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}};
}

}  // namespace st

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

/// Return the block of a larger matrix with this first row and column.
template <int R, int C, int M, int N>
Matrix<R, C> block(const Matrix<M, N> &A, int row, int column) {
    Matrix<R, C> B;
    for (int i = 0; i < R; ++i) {
        for (int j = 0; j < C; ++j) {
            B[i][j] = A[row + i][column + j];
        }
    }
    return B;
}

/// Replace that block by B.
template <int R, int C, int M, int N>
void set_block(Matrix<M, N> &A, int row, int column, const Matrix<R, C> &B) {
    for (int i = 0; i < R; ++i) {
        for (int j = 0; j < C; ++j) {
            A[row + i][column + j] = B[i][j];
        }
    }
}

/// Return the first elements of a longer vector.
template <int R, int N>
Vector<R> first(const Vector<N> &v) {
    static_assert(R <= N);
    Vector<R> part;
    for (int i = 0; i < R; ++i) {
        part[i] = v[i];
    }
    return part;
}

template <int N>
Vector<N> operator+(const Vector<N> &a, const Vector<N> &b) {
    Vector<N> sum;
    for (int i = 0; i < N; ++i) {
        sum[i] = a[i] + b[i];
    }
    return sum;
}

template <int N>
Vector<N> operator-(const Vector<N> &a, const Vector<N> &b) {
    Vector<N> difference;
    for (int i = 0; i < N; ++i) {
        difference[i] = a[i] - b[i];
    }
    return difference;
}

/// Return A^-1 B and the determinant of A, by Gauss and Jordan with pivots (Golub and Van Loan, Matrix
/// Computations, 3.4); not finite if A is singular.
template <int N, int C>
Matrix<N, C> solved_by_pivots(Matrix<N, N> A, Matrix<N, C> B, double &determinant) {
    determinant = 1.0;
    for (int column = 0; column < N; ++column) {
        int pivot = column;
        for (int row = column + 1; row < N; ++row) {
            pivot = std::fabs(A[row][column]) > std::fabs(A[pivot][column]) ? row : pivot;
        }
        if (pivot != column) {
            determinant = -determinant;
            for (int k = 0; k < N; ++k) {
                const double a = A[column][k];
                A[column][k] = A[pivot][k];
                A[pivot][k] = a;
            }
            for (int k = 0; k < C; ++k) {
                const double b = B[column][k];
                B[column][k] = B[pivot][k];
                B[pivot][k] = b;
            }
        }
        determinant *= A[column][column];
        const double scale = 1 / A[column][column];
        for (int k = 0; k < N; ++k) {
            A[column][k] *= scale;
        }
        for (int k = 0; k < C; ++k) {
            B[column][k] *= scale;
        }
        for (int row = 0; row < N; ++row) {
            const double factor = A[row][column];
            if (row != column && factor != 0) {
                for (int k = 0; k < N; ++k) {
                    A[row][k] -= factor * A[column][k];
                }
                for (int k = 0; k < C; ++k) {
                    B[row][k] -= factor * B[column][k];
                }
            }
        }
    }
    return B;
}

/// Return A^-1 and the determinant of A.
template <int N>
Matrix<N, N> inverse_and_determinant(const Matrix<N, N> &A, double &determinant) {
    return solved_by_pivots(A, identity<N>(), determinant);
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Symmetric matrices: inverses of covariances and of information.

#pragma once

#include "maths/matrix.h"

namespace st {

/// adj(A) = det(A) A^-1 of a symmetric 3 x 3 matrix.
struct Adjugate {
    double xx, xy, xz, yy, yz, zz;
};

/// Of the upper left block of A, which may be larger.
template <int N>
Adjugate adjugate(const Matrix<N, N> &A) {
    static_assert(N >= 3);
    const double xx = A[0][0], xy = A[0][1], xz = A[0][2];
    const double yy = A[1][1], yz = A[1][2], zz = A[2][2];
    return {yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy,
            xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy};
}

/// Return the determinant of the upper left 3 x 3 block of a symmetric A.
template <int N>
double determinant(const Matrix<N, N> &A) {
    const Adjugate adj = adjugate(A);
    return A[0][0] * adj.xx + A[0][1] * adj.xy + A[0][2] * adj.xz;
}

/// Return adj(A) / det(A) of the upper left 3 x 3 block of a symmetric A; not finite if singular.
template <int N>
Matrix3 inverse(const Matrix<N, N> &A) {
    const Adjugate adj = adjugate(A);
    const double scale = 1 / (A[0][0] * adj.xx + A[0][1] * adj.xy + A[0][2] * adj.xz);
    return {{{adj.xx * scale, adj.xy * scale, adj.xz * scale},
             {adj.xy * scale, adj.yy * scale, adj.yz * scale},
             {adj.xz * scale, adj.yz * scale, adj.zz * scale}}};
}

/// Whether the upper left 3 x 3 block of a symmetric A is positive definite: Sylvester's
/// criterion; false for NaN.
template <int N>
bool is_positive_definite(const Matrix<N, N> &A) {
    return A[0][0] > 0 && A[0][0] * A[1][1] - A[0][1] * A[0][1] > 0 && determinant(A) > 0;
}

/// Fill L, the lower triangle with A = L L^T of a symmetric A; false, with L undefined, where A is
/// not positive definite or has NaN (Golub and Van Loan, Matrix Computations, algorithm 4.2.1).
template <int N>
bool cholesky(const Matrix<N, N> &A, Matrix<N, N> &L) {
    L = {};
    for (int j = 0; j < N; ++j) {
        double pivot = A[j][j];
        for (int k = 0; k < j; ++k) {
            pivot -= L[j][k] * L[j][k];
        }
        if (!(pivot > 0)) {
            return false;
        }
        L[j][j] = std::sqrt(pivot);
        for (int i = j + 1; i < N; ++i) {
            double sum = A[i][j];
            for (int k = 0; k < j; ++k) {
                sum -= L[i][k] * L[j][k];
            }
            L[i][j] = sum / L[j][j];
        }
    }
    return true;
}

/// Return X with L L^T X = B: forward, then back substitution.
template <int N, int C>
Matrix<N, C> solved(const Matrix<N, N> &L, Matrix<N, C> B) {
    for (int c = 0; c < C; ++c) {
        for (int i = 0; i < N; ++i) {
            for (int k = 0; k < i; ++k) {
                B[i][c] -= L[i][k] * B[k][c];
            }
            B[i][c] /= L[i][i];
        }
        for (int i = N - 1; i >= 0; --i) {
            for (int k = i + 1; k < N; ++k) {
                B[i][c] -= L[k][i] * B[k][c];
            }
            B[i][c] /= L[i][i];
        }
    }
    return B;
}

}  // namespace st

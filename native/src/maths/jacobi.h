// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Eigenvalues and singular values of small matrices by Jacobi's methods, which lose no digits of the
// small ones (Golub and Van Loan, Matrix Computations, 8.5 and 8.6.3).

#pragma once

#include <cmath>

#include "maths/matrix.h"

namespace st {

/// More than any matrix needs: the methods converge quadratically.
constexpr int MOST_SWEEPS = 30;

/// Cosine and sine of the rotation that makes two vectors orthogonal, or a symmetric 2 x 2 matrix
/// diagonal, with p, q on its diagonal and c next to it.
struct PlaneRotation {
    double cosine, sine;

    static PlaneRotation of(double p, double q, double c) {
        const double zeta = (q - p) / (2 * c);
        const double t = (zeta < 0 ? -1.0 : 1.0) / (std::fabs(zeta) + std::sqrt(1 + zeta * zeta));
        const double cosine = 1 / std::sqrt(1 + t * t);
        return {cosine, cosine * t};
    }
};

/// Turn columns p and q.
template <int R, int C>
void turn_columns(const PlaneRotation &turn, int p, int q, Matrix<R, C> &A) {
    for (int i = 0; i < R; ++i) {
        const double a = A[i][p], b = A[i][q];
        A[i][p] = turn.cosine * a - turn.sine * b;
        A[i][q] = turn.sine * a + turn.cosine * b;
    }
}

/// Eigenvalues of a symmetric matrix, ascending, with unit eigenvectors in the columns of V.
template <int N>
struct Eigen {
    Vector<N> value;
    Matrix<N, N> V;
};

/// Exchange columns, and their values, so that these ascend.
template <int R, int N>
void sort_columns(Vector<N> &value, Matrix<R, N> &A, Matrix<N, N> &B) {
    for (int k = 0; k < N; ++k) {
        for (int m = k + 1; m < N; ++m) {
            if (value[m] < value[k]) {
                const double moved = value[k];
                value[k] = value[m];
                value[m] = moved;
                // A turn by a right angle: it exchanges two columns, one with the other sign.
                turn_columns({0.0, 1.0}, k, m, A);
                turn_columns({0.0, 1.0}, k, m, B);
            }
        }
    }
}

template <int N>
Eigen<N> symmetric_eigen(Matrix<N, N> A) {
    Matrix<N, N> V = identity<N>();
    for (int sweep = 0; sweep < MOST_SWEEPS; ++sweep) {
        bool turned = false;
        for (int p = 0; p < N; ++p) {
            for (int q = p + 1; q < N; ++q) {
                if (!(std::fabs(A[p][q]) >
                      1e-300 + 1e-17 * (std::fabs(A[p][p]) + std::fabs(A[q][q])))) {
                    continue;
                }
                const auto turn = PlaneRotation::of(A[p][p], A[q][q], A[p][q]);
                turn_columns(turn, p, q, A);
                A = transposed(A);
                turn_columns(turn, p, q, A);
                A[p][q] = A[q][p] = 0.0;
                turn_columns(turn, p, q, V);
                turned = true;
            }
        }
        if (!turned) {
            break;
        }
    }
    Vector<N> value;
    for (int k = 0; k < N; ++k) {
        value[k] = A[k][k];
    }
    sort_columns(value, V, A);
    return {value, V};
}

/// A = U S V^T with singular values ascending; columns of U S, whose lengths they are, and of V.
template <int N>
struct Singular {
    Vector<N> value;
    Matrix<N, N> US, V;
};

template <int N>
Singular<N> singular_values(Matrix<N, N> A) {
    Matrix<N, N> V = identity<N>();
    for (int sweep = 0; sweep < MOST_SWEEPS; ++sweep) {
        bool turned = false;
        for (int p = 0; p < N; ++p) {
            for (int q = p + 1; q < N; ++q) {
                double pp = 0.0, qq = 0.0, pq = 0.0;
                for (int i = 0; i < N; ++i) {
                    pp += A[i][p] * A[i][p];
                    qq += A[i][q] * A[i][q];
                    pq += A[i][p] * A[i][q];
                }
                if (!(std::fabs(pq) > 1e-300 + 1e-16 * std::sqrt(pp * qq))) {
                    continue;
                }
                const auto turn = PlaneRotation::of(pp, qq, pq);
                turn_columns(turn, p, q, A);
                turn_columns(turn, p, q, V);
                turned = true;
            }
        }
        if (!turned) {
            break;
        }
    }
    Vector<N> value;
    for (int k = 0; k < N; ++k) {
        double square = 0.0;
        for (int i = 0; i < N; ++i) {
            square += A[i][k] * A[i][k];
        }
        value[k] = std::sqrt(square);
    }
    sort_columns(value, A, V);
    return {value, A, V};
}

}  // namespace st

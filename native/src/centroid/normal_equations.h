// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Normal equations N x = g of one star's window: N = J^T W J and g = J^T W r.
//
// J holds the derivatives of the model F a(x) d(y) + B of a pixel, each a product of a factor of its
// column x and one of its row y:
//
//     J_u = F a_u d,  J_v = F a d_v,  J_F = a d,  J_B = 1,  J_sigma = F (a_sigma d + a d_sigma)
//
// W is the diagonal of the weights w, r the residuals. The sums over y, such as W_DD = sum_y w d^2,
// are taken first, for LANES columns at a time in registers. What is left are sums over x, such as
// N_uu = F^2 sum_x a_u^2 W_DD.

#pragma once

#include "centroid/psf.h"
#include "maths/lanes.h"
#include "maths/matrix.h"

namespace st {

constexpr double RIDGE = 1e-12;  // keeps N regular without usable pixels or without flux

/// Sums over the rows of some columns: of w and of w r, times d, v = d_v and s = d_sigma.
struct ColumnSums {
    Lanes w{}, w_d{}, w_v{}, w_dd{}, w_dv{}, w_vv{}, r{}, r_d{}, r_v{}, chi2{};
    Lanes w_s{}, w_ds{}, w_vs{}, w_ss{}, r_s{};  // which only a free sigma needs

    /// Add a row with weights w and residuals.
    template <int P>
    void add(Lanes weight, Lanes residual, float d, float v, float s) {
        const Lanes weighted = weight * residual, wd = weight * d, wv = weight * v;
        w += weight;
        w_d += wd;
        w_v += wv;
        w_dd += wd * d;
        w_dv += wd * v;
        w_vv += wv * v;
        r += weighted;
        r_d += weighted * d;
        r_v += weighted * v;
        chi2 += weighted * residual;
        if constexpr (P > SIGMA) {
            const Lanes ws = weight * s;
            w_s += ws;
            w_ds += ws * d;
            w_vs += ws * v;
            w_ss += ws * s;
            r_s += weighted * s;
        }
    }
};

/// Sums over the columns, of which N and g are made for P = 4 or 5 parameters.
template <int P>
class Equations {
public:
    /// Add LANES columns from x on; columns is the profile of the star along u.
    void add(const ColumnSums &y, const Profile<float> &columns, int x) {
        const Lanes a = load(columns.share + x), a_u = load(columns.d_centre + x);
        const Lanes aa = a * a, a_ua = a_u * a;
        g_u_ += a_u * y.r_d;
        g_v_ += a * y.r_v;
        g_f_ += a * y.r_d;
        g_b_ += y.r;
        chi2_ += y.chi2;
        uu_ += a_u * a_u * y.w_dd;
        uv_ += a_ua * y.w_dv;
        uf_ += a_ua * y.w_dd;
        ub_ += a_u * y.w_d;
        vv_ += aa * y.w_vv;
        vf_ += aa * y.w_dv;
        vb_ += a * y.w_v;
        ff_ += aa * y.w_dd;
        fb_ += a * y.w_d;
        bb_ += y.w;
        if constexpr (P > SIGMA) {
            const Lanes a_s = load(columns.d_sigma + x);
            // J_sigma has two products.
            us_ += a_u * (a_s * y.w_dd + a * y.w_ds);
            vs_ += a * (a_s * y.w_dv + a * y.w_vs);
            fs_ += a * (a_s * y.w_dd + a * y.w_ds);
            bs_ += a_s * y.w_d + a * y.w_s;
            ss_ += a_s * a_s * y.w_dd + a * (a_s * y.w_ds + a_s * y.w_ds + a * y.w_ss);
            g_s_ += a_s * y.r_d + a * y.r_s;
        }
    }

    /// Fill N and g of a star of this flux; return chi-square, sum w r^2.
    double solve_for(double flux, Matrix<P, P> &N, Vector<P> &g) const {
        const double square = flux * flux;
        g[U] = flux * total(g_u_);
        g[V] = flux * total(g_v_);
        g[FLUX] = total(g_f_);
        g[LEVEL] = total(g_b_);
        N[U][U] = square * total(uu_);
        N[U][V] = square * total(uv_);
        N[U][FLUX] = flux * total(uf_);
        N[U][LEVEL] = flux * total(ub_);
        N[V][V] = square * total(vv_);
        N[V][FLUX] = flux * total(vf_);
        N[V][LEVEL] = flux * total(vb_);
        N[FLUX][FLUX] = total(ff_);
        N[FLUX][LEVEL] = total(fb_);
        N[LEVEL][LEVEL] = total(bb_);
        if constexpr (P > SIGMA) {
            g[SIGMA] = flux * total(g_s_);
            N[U][SIGMA] = square * total(us_);
            N[V][SIGMA] = square * total(vs_);
            N[FLUX][SIGMA] = flux * total(fs_);
            N[LEVEL][SIGMA] = flux * total(bs_);
            N[SIGMA][SIGMA] = square * total(ss_);
        }
        make_regular(N);
        return total(chi2_);
    }

    /// Complete a symmetric N, of which the upper triangle is filled.
    static void make_regular(Matrix<P, P> &N) {
        for (int p = 0; p < P; ++p) {
            N[p][p] = N[p][p] * (1 + RIDGE) + RIDGE;
            for (int q = 0; q < p; ++q) {
                N[p][q] = N[q][p];
            }
        }
    }

private:
    static double total(Lanes lanes) { return static_cast<double>(sum(lanes)); }

    Lanes g_u_{}, g_v_{}, g_f_{}, g_b_{}, chi2_{};
    Lanes uu_{}, uv_{}, uf_{}, ub_{}, vv_{}, vf_{}, vb_{}, ff_{}, fb_{}, bb_{};
    Lanes us_{}, vs_{}, fs_{}, bs_{}, ss_{}, g_s_{};
};

/// Invert a positive definite matrix in place, by Gauss-Jordan elimination.
template <int P>
void invert(Matrix<P, P> &A) {
    for (int k = 0; k < P; ++k) {
        const double scale = 1 / A[k][k];
        A[k][k] = 1;
        for (int q = 0; q < P; ++q) {
            A[k][q] *= scale;
        }
        for (int p = 0; p < P; ++p) {
            if (p != k) {
                const double factor = A[p][k];
                A[p][k] = 0;
                for (int q = 0; q < P; ++q) {
                    A[p][q] -= factor * A[k][q];
                }
            }
        }
    }
}

}  // namespace st

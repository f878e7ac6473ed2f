// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Weighted least squares fit of pixel-integrated Gaussians to all stars of an image.
//
// The model of the pixels in a star's window is F a(x) d(y) + B + neighbours (psf.h), F the flux and
// B the level above the mesh background. Gauss-Newton steps x = N^-1 g solve the normal equations
// (normal_equations.h) until chi-square, sum w r^2, is least. The covariance is the inverse of the
// information N.

#pragma once

#include "centroid/noise.h"
#include "centroid/normal_equations.h"
#include "centroid/psf.h"
#include "centroid/windows.h"

namespace st {

constexpr int ITERATIONS = 12;
constexpr double CONVERGED_PX = 3e-4;  // a shorter step ends the iteration

/// A fitted star, with the covariance of its first P = 4 or 5 parameters; dof are the degrees of
/// freedom, pixels less parameters.
template <int P>
struct Fit {
    Star star;
    Matrix<P, P> covariance;
    double chi2;
    int dof;
};

/// A star with its window, and work memory of the fit.
///
/// columns and rows are its profile, neighbours the flux of other stars in the window. After the
/// last iteration model is F a d, that of the star itself; own the data without neighbours and
/// level, so that the residual is own - model; weight 1 / variance of the pixels, 0 if not used.
struct FitWork {
    Window window;
    Profile<float> columns, rows, other_columns, other_rows;
    alignas(16) float neighbours[MOST_AREA_PX];
    alignas(16) float model[MOST_AREA_PX];
    alignas(16) float own[MOST_AREA_PX];
    alignas(16) float weight[MOST_AREA_PX];
};

/// Fill N, g and chi-square of a star in work.window, whose neighbours are there if it has any.
template <int P>
double normal_equations(const Star &star, const NoiseModel &noise, bool lone, FitWork &work,
                        Matrix<P, P> &N, Vector<P> &g);

/// Move a star by the limited step N^-1 g; return its length in px.
template <int P>
double move(Star &star, const Matrix<P, P> &covariance, const Vector<P> &g);

/// Set work.neighbours to zero, or add a star to them.
void clear_neighbours(FitWork &work);
void add_neighbour(const Star &star, FitWork &work);

/// Fill model, own and weight of a star, for which normal_equations() was called last.
void set_model(const Star &star, const NoiseModel &noise, bool lone, FitWork &work);

/// Fit all stars by Gauss-Newton from the stars in fit (count), with P free parameters.
///
/// cut(i, window) fills the window of a star; use(i) is called for each star once, when work has
/// its window and model at its last parameters.
///
/// The weights follow the model, not the data, which would bias the flux low: with noise that
/// follows the model too this is maximum likelihood. Neighbours are fitted in turns: each star to
/// the data less the others' last model, until all stars of the image have converged. Stars
/// without neighbours do not depend on any: each is fitted to its end.
template <int P, class Cut, class Use>
void fit_stars(Fit<P> *fit, int count, const Neighbours &neighbours, const NoiseModel &noise,
               int iterations, Cut cut, Use use, FitWork &work) {
    Vector<P> g;
    const auto finish = [&](int i, bool lone) {
        set_model(fit[i].star, noise, lone, work);
        fit[i].dof = work.window.pixels_used() - P;
        use(i);
    };
    int passes = 0;
    bool any_neighbours = false;
    for (int i = 0; i < count; ++i) {
        if (!neighbours.lone(i)) {
            any_neighbours = true;
            continue;
        }
        Fit<P> &one = fit[i];
        cut(i, work.window);
        int pass = 0;
        for (bool converged = false;; ++pass) {
            one.chi2 = normal_equations(one.star, noise, true, work, one.covariance, g);
            invert(one.covariance);
            if (converged || pass == iterations) {
                break;
            }
            converged = move(one.star, one.covariance, g) < CONVERGED_PX;
        }
        passes = pass > passes ? pass : passes;
        finish(i, true);
    }
    if (!any_neighbours) {
        return;
    }
    bool converged = false;
    for (int pass = 0; pass <= iterations; ++pass) {
        const bool last = pass == iterations || (converged && pass >= passes);
        converged = true;
        for (int i = 0; i < count; ++i) {
            if (neighbours.lone(i)) {
                continue;
            }
            Fit<P> &one = fit[i];
            cut(i, work.window);
            clear_neighbours(work);
            neighbours.each(i, [&](int j) { add_neighbour(fit[j].star, work); });
            one.chi2 = normal_equations(one.star, noise, false, work, one.covariance, g);
            invert(one.covariance);
            if (last) {
                finish(i, false);
            } else if (!(move(one.star, one.covariance, g) < CONVERGED_PX)) {
                converged = false;
            }
        }
        if (last) {
            break;
        }
    }
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Maximum-likelihood fit of streaks: a Gaussian, moved along a line during the exposure.
//
// With a and b the coordinates of a pixel along and across the streak, from its middle, the flux of
// a star of flux F, streak length L and width sigma is
//
//     I = F g(b) h(a),    g(b) = phi(b / s) / s,
//     h(a) = (Phi((a + L/2) / s) - Phi((a - L/2) / s)) / L,    s^2 = sigma^2 + 1/12,
//
// phi the normal density and Phi its integral. The 1/12 is the variance of a pixel in any direction:
// a streak crosses pixels at all phases, so that it need not be integrated over each. Gauss-Newton
// steps as in gaussian_fit.h, with weights that follow the model.

#pragma once

#include "centroid/background.h"
#include "centroid/image.h"
#include "centroid/noise.h"
#include "centroid/psf.h"
#include "maths/arena.h"

namespace st {

enum { LENGTH = SIGMA + 1, ANGLE };  // px, and rad from +u towards +v
using StreakStar = Vector<7>;        // parameters of a star, then these

constexpr double LEAST_LENGTH_PX = 0.3;

/// A fitted streak, with the covariance of its first P = 4 parameters, or of all 7; chi2 and dof are
/// 0 where no pixel can be used.
template <int P>
struct StreakFit {
    StreakStar star;
    Matrix<P, P> covariance;
    double chi2;
    int dof;
};

/// The background of a star: its level in DN is level + across x + down y at pixel x, y; variance
/// DN^2 that of a pixel.
struct Sky {
    double level, across, down, variance;
};

/// Return the background of the mesh around a place.
Sky sky_at(const Mesh &mesh, Place place, double variance);

/// What a fit sees: an image, of which pixels from full_scale DN on are left out, and the
/// background of each star.
struct StreakPixels {
    const Image &image;
    double full_scale_dn;
    const Sky *sky;

    /// Return a pixel less the background of star i.
    double above(int i, int x, int y) const {
        return image.at(x, y) - (sky[i].level + sky[i].across * x + sky[i].down * y);
    }
};

/// Return parameters of a streak at a place, without flux.
StreakStar streak_at(Place place, Place streak_px, double sigma_px);

/// Fit streaks from the stars in fit (count), with P parameters free. The arena needs
/// streak_fit_bytes(count).
template <int P>
void fit_streaks(const StreakPixels &pixels, StreakFit<P> *fit, int count, const NoiseModel &noise,
                 int iterations, Arena &arena);

size_t streak_fit_bytes(int count);

/// Return the flux of streak i at its position, level free.
double flux_at(const StreakPixels &pixels, int i, const StreakStar &star);

/// Return the DN of a photo-electron, by the residuals r of all streaks.
///
/// With the variance V of the background and the flux I, the mean of r^2 - V is gain I; by least
/// squares the gain is sum(w I (r^2 - V)) / sum(w I^2), w = 1 / (V + gain_0 I)^2.
double photon_gain(const StreakPixels &pixels, const StreakFit<4> *fit, int count,
                   const NoiseModel &noise);

/// A streak with what does not depend on the pixel.
class StreakShape {
public:
    StreakShape() = default;
    explicit StreakShape(const StreakStar &star);

    /// Return the coordinates of a pixel along and across the streak.
    double along(double x, double y) const { return (x - u_) * c_ + (y - v_) * s_; }
    double across(double x, double y) const { return (y - v_) * c_ - (x - u_) * s_; }

    /// Return I / F at a pixel.
    double share_at(double x, double y) const;

    /// Fill the derivatives of the flux I at (a, b) along and across by the first P parameters;
    /// return I.
    template <int P>
    double derivatives(double a, double b, Vector<P> &row) const;

    double width() const { return width_; }
    double length() const { return length_; }
    double flux() const { return flux_; }

private:
    double u_, v_, flux_, sigma_, length_, c_, s_, width_;
};

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The fit of a lens to the stars of one image.
//
// A lens here is a camera model and an attitude. The parameters d (3), a, b, g, h, k (1) change it:
// the attitude by a turn d about the sensor axes, the focal length by e^a, the pixel ratio by e^b,
// the principal point by w (g, h), w the width, and k1 by k. Those of a fisheye have k (4) of k1 to
// k4.
//
// Fisheyes are near one family of projections, r / f = sin(b theta) / b: b = 1 orthographic, 1/2
// equisolid, 0 equidistant, and tan(c theta) / c beyond, c = 1/2 stereographic. Its series has
// k1 = -b^2 / 6 or c^2 / 3 and the other terms c_n(k1), tail_of_projection(). The prior of k_n,
// n = 2 to 4, has the mean c_n(k1) at the k1 of each step. Its weight is that of a t-distribution,
// as the stars have it: a lens unlike the family is followed where the stars show it.

#pragma once

#include <cstdint>

#include "camera/lens.h"
#include "startracker_ground.h"

namespace st {

constexpr int MOST_PARAMETERS = ST_MOST_LENS_PARAMETERS;
constexpr int RADIAL = 7;  // where k begins

using Parameters = Vector<MOST_PARAMETERS>;
using ParameterMatrix = Matrix<MOST_PARAMETERS, MOST_PARAMETERS>;

/// A lens and the attitude of its camera, q_icrf_from_sensor.
struct LensView {
    Lens lens;
    Quaternion q;
};

/// Where a fit begins: prior standard deviations of so many parameters about those of a lens, of k2 to
/// k4 of a fisheye about the family of projections.
struct LensPrior {
    Lens start;
    const double *free;
    int parameters;
};

/// A fitted lens, the covariance of its parameters and the error per axis that the residuals show.
struct LensFit {
    LensView view;
    ParameterMatrix P;
    double error_px;
};

/// Directions of stars in ICRF, and spots of an image with their errors per axis.
struct SkyAndSpots {
    const Vector3 *direction;
    const Point *spot;
    const double *sigma_px;
    int stars, spots;
};

/// The terms k2 to k4 of a projection of the family, and their derivatives by k1.
struct ProjectionTail {
    double term[3], slope[3];
};

/// Return those of the projection that has k1.
ProjectionTail tail_of_projection(double k1);

/// Return a lens with its parameters changed; those that it does not have are zero.
LensView changed(const LensView &view, const Parameters &change);

/// Return the derivatives of a pixel at undistorted coordinates by so many parameters; the others are
/// zero.
Matrix<2, MOST_PARAMETERS> derivatives(const Lens &lens, const Point &plane, const Point &pixel,
                                       int parameters);

/// Fit a lens, which the result has at first, to spots that are stars, -1 for none, by steps of Gauss
/// and Newton. square has room for the spots.
void fit_lens(const LensPrior &prior, const SkyAndSpots &seen, const int32_t *star, double *square,
              LensFit &fit);

/// Return the cosine of the largest angle between the axis and a corner of the image: farther off a
/// distortion may fold back into it. Of a lens that has no inverse there, that without distortion.
double least_cosine(const Lens &lens);

/// Return the pixel of a star on sensor axes that is in the image, NaN else.
Point pixel_in_image(const Lens &lens, double least, const Vector3 &sensor);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The camera model: directions to pixels and back.
//
// A direction (x, y, z) has undistorted image coordinates (a, b) of unit focal length: x / z, y / z
// for plumb_bob (Brown, Photogramm. Eng. 32, 1966) and rational_polynomial; theta (x, y) /
// sqrt(x^2 + y^2), theta the angle to the optical axis, for equidistant (Kannala and Brandt, IEEE
// Trans. PAMI 28, 2006). With s = a^2 + b^2 and
//
//     L = (1 + k1 s + k2 s^2 + k3 s^3 + k4 s^4) / (1 + d1 s + d2 s^2 + d3 s^3)
//
// the distorted coordinates are a L + 2 p1 a b + p2 (s + 2 a^2), b L + p1 (s + 2 b^2) + 2 p2 a b.
// Focal lengths and principal point make pixels of them.

#pragma once

#include <cmath>

#include "maths/matrix.h"
#include "maths/rotation.h"
#include "startracker.h"

namespace st {

struct Terms {
    double k1, k2, p1, p2, k3, k4, d1, d2, d3;
};

/// distorted is whether any term is not zero; equidistant whether (a, b) is an angle; farthest_rad
/// the largest angle to the axis that has a pixel, infinite for other lenses.
struct Lens {
    int width, height;
    double fx, fy, cx, cy;
    Terms terms;
    bool distorted, equidistant;
    double farthest_rad;
};

/// Undistorted or distorted image coordinates, or a pixel.
struct Point {
    double x, y;
};

/// Symmetric derivative of distort(): dx/da, dx/db = dy/da, dy/db.
struct Jacobian2 {
    double xx, cross, yy;
};

/// d(u, v) / d(angle about each sensor axis), px/rad: the image motion per body rate.
using Flow = Matrix<2, 3>;

/// Return the model of a camera that st_check_camera() accepts.
Lens lens_of(const st_camera &camera);

/// Return the largest angle to the axis that has a pixel: beyond, an equidistant lens folds.
/// Infinity for other lenses, which must not fold within their images.
double farthest_angle(bool equidistant, const Terms &terms);

/// Whether a pixel is in the image; false for NaN.
inline bool shows(const Lens &lens, const Point &pixel) {
    return -0.5 <= pixel.x && pixel.x <= lens.width - 0.5 && -0.5 <= pixel.y &&
           pixel.y <= lens.height - 0.5;
}

/// Return a, b of a direction; NaN where it has none: behind a camera, or straight back.
inline Point plane_point(bool equidistant, const Vector3 &direction) {
    const double x = direction[0], y = direction[1], z = direction[2];
    if (equidistant) {
        const double r = std::hypot(x, y);
        if (r > 0) {
            const double scale = std::atan2(r, z) / r;
            return {scale * x, scale * y};
        }
        return z > 0 ? Point{0.0, 0.0} : Point{NAN, NAN};
    }
    return z > 0 ? Point{x / z, y / z} : Point{NAN, NAN};
}

/// Return the unit vector of undistorted coordinates.
inline Vector3 ray(bool equidistant, const Point &plane) {
    const double a = plane.x, b = plane.y;
    if (equidistant) {
        const double theta = std::hypot(a, b);
        const double scale = theta > 0 ? std::sin(theta) / theta : 1.0;
        return {{scale * a, scale * b, std::cos(theta)}};
    }
    const double scale = 1 / std::sqrt(a * a + b * b + 1);
    return {{scale * a, scale * b, scale}};
}

/// Return the distorted coordinates of a, b.
inline Point distort(const Terms &terms, const Point &plane) {
    const auto [k1, k2, p1, p2, k3, k4, d1, d2, d3] = terms;
    const double a = plane.x, b = plane.y, s = a * a + b * b;
    const double L =
        (1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) / (1 + s * (d1 + s * (d2 + s * d3)));
    return {a * L + 2 * p1 * a * b + p2 * (s + 2 * a * a),
            b * L + p1 * (s + 2 * b * b) + 2 * p2 * a * b};
}

/// Return the derivative of distort() at a, b.
inline Jacobian2 distortion_jacobian(const Terms &terms, const Point &plane) {
    const auto [k1, k2, p1, p2, k3, k4, d1, d2, d3] = terms;
    const double a = plane.x, b = plane.y, s = a * a + b * b;
    const double D = 1 + s * (d1 + s * (d2 + s * d3));
    const double L = (1 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) / D;
    const double dN_ds = k1 + s * (2 * k2 + s * (3 * k3 + s * 4 * k4));
    const double dD_ds = d1 + s * (2 * d2 + s * 3 * d3);
    const double slope = 2 * (dN_ds - L * dD_ds) / D;
    return {L + slope * a * a + 2 * p1 * b + 6 * p2 * a, slope * a * b + 2 * (p1 * a + p2 * b),
            L + slope * b * b + 6 * p1 * b + 2 * p2 * a};
}

/// Return the inverse of distort(), by Newton's method; NaN where a pixel has no direction: beyond
/// the farthest angle, outside the image circle of a fisheye, or where the method finds none.
Point undistort(const Lens &lens, const Point &distorted);

/// Return the pixel of undistorted coordinates; NaN beyond the farthest angle.
inline Point pixel_of(const Lens &lens, const Point &plane) {
    if (!(plane.x * plane.x + plane.y * plane.y <= lens.farthest_rad * lens.farthest_rad)) {
        return {NAN, NAN};
    }
    const Point distorted = distort(lens.terms, plane);
    return {lens.fx * distorted.x + lens.cx, lens.fy * distorted.y + lens.cy};
}

/// Return the pixel of a direction; NaN where it has none.
inline Point project(const Lens &lens, const Vector3 &direction) {
    return pixel_of(lens, plane_point(lens.equidistant, direction));
}

/// Return the undistorted coordinates of a pixel; NaN where it has none.
inline Point undistorted(const Lens &lens, const Point &pixel) {
    return undistort(lens, {(pixel.x - lens.cx) / lens.fx, (pixel.y - lens.cy) / lens.fy});
}

/// Return the unit vector of a pixel; NaN where it has none.
inline Vector3 unproject(const Lens &lens, const Point &pixel) {
    return ray(lens.equidistant, undistorted(lens, pixel));
}

/// Return the image motion per body rate at undistorted coordinates a, b.
///
/// A direction d moves by -e x d where the body turns about an axis e. Then (da, db) is
/// (h a b, c + h b^2), -(c + h a^2, h a b) and (b, -a) for the three axes; c = h = 1 where a, b are
/// x / z, y / z, and c = theta cot theta, h = (1 - c) / theta^2 for an equidistant lens.
Flow image_flow(const Lens &lens, const Point &plane);

/// Whether distort() has an inverse over the image and does not fold it; fills the fault, which may be
/// null, otherwise. Pixels outside the image circle of a fisheye do not count.
bool image_does_not_fold(const Lens &lens, st_fault *fault);

/// Return the largest angle between the optical axis and a corner of the image or of its circle.
double corner_angle(const Lens &lens);

/// Return the rotation from the axes of the middle of the image, +z through the middle and +y down
/// along the image, to sensor axes.
Quaternion middle_axes(const Lens &lens);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "camera/lens.h"

namespace st {
namespace {

constexpr double ANGLE_STEP_RAD = 1.0 / 256;
// The largest angle of a pixel to the optical axis: straight back is not a direction.
constexpr double LARGEST_RAD = 175 * M_PI / 180;
// Errors of an inverse in focal lengths: none, and the largest one.
constexpr double EXACT = 1e-14, LARGEST_ERROR = 1e-9;
constexpr int MOST_STEPS = 60, MOST_NEWTON_STEPS = 20;

/// Return d r / d theta of the distorted radius r of an equidistant lens at theta^2 = s.
double radius_slope(const Terms &t, double s) {
    return 1 + s * (3 * t.k1 + s * (5 * t.k2 + s * (7 * t.k3 + s * 9 * t.k4)));
}

/// Return the angle to the axis at a distorted radius r of an equidistant lens, NaN for none.
///
/// The radius grows up to the farthest angle. A step of Newton's method that leaves the bounds
/// found so far is one to their middle: near the edge of an image circle it would go far beyond.
double angle_at(const Lens &lens, double r) {
    const Terms &t = lens.terms;
    double low = 0.0, high = lens.farthest_rad;
    double theta = r < high ? r : high, beyond = INFINITY;
    for (int step = 0; step < MOST_STEPS; ++step) {
        const double s = theta * theta;
        beyond = theta * (1 + s * (t.k1 + s * (t.k2 + s * (t.k3 + s * t.k4)))) - r;
        if (std::fabs(beyond) < EXACT) {
            break;
        }
        (beyond > 0 ? high : low) = theta;
        theta -= beyond / radius_slope(t, s);
        if (!(low < theta && theta < high)) {
            theta = (low + high) / 2;
        }
    }
    return std::fabs(beyond) < LARGEST_ERROR ? theta : NAN;
}

}  // namespace

double farthest_angle(bool equidistant, const Terms &terms) {
    if (!equidistant) {
        return INFINITY;
    }
    for (int step = 1; step * ANGLE_STEP_RAD < LARGEST_RAD; ++step) {
        const double theta = step * ANGLE_STEP_RAD;
        if (!(radius_slope(terms, theta * theta) > 0)) {
            return theta - ANGLE_STEP_RAD;
        }
    }
    return LARGEST_RAD;
}

Lens lens_of(const st_camera &camera) {
    const double *c = camera.distortion;
    Terms terms{};
    if (camera.model == ST_EQUIDISTANT) {
        terms = {c[0], c[1], 0.0, 0.0, c[2], c[3], 0.0, 0.0, 0.0};
    } else if (camera.model == ST_RATIONAL_POLYNOMIAL) {
        terms = {c[0], c[1], c[2], c[3], c[4], 0.0, c[5], c[6], c[7]};
    } else {
        terms = {c[0], c[1], c[2], c[3], c[4], 0.0, 0.0, 0.0, 0.0};
    }
    bool distorted = false;
    for (int i = 0; i < 8; ++i) {
        distorted |= c[i] != 0;
    }
    const bool equidistant = camera.model == ST_EQUIDISTANT;
    return {camera.width_px, camera.height_px,
            camera.fx_px,    camera.fy_px,
            camera.cx_px,    camera.cy_px,
            terms,           distorted,
            equidistant,     farthest_angle(equidistant, terms)};
}

Point undistort(const Lens &lens, const Point &distorted) {
    const double x = distorted.x, y = distorted.y;
    if (lens.equidistant) {
        const double r = std::hypot(x, y), scale = r > 0 ? angle_at(lens, r) / r : 1.0;
        return {scale * x, scale * y};
    }
    Point plane = distorted;
    double error = lens.distorted ? INFINITY : 0.0;
    for (int step = 0; lens.distorted && step < MOST_NEWTON_STEPS; ++step) {
        const Point found = distort(lens.terms, plane);
        const double ex = found.x - x, ey = found.y - y;
        error = std::fmax(std::fabs(ex), std::fabs(ey));
        if (error < EXACT) {
            break;
        }
        const auto [xx, cross, yy] = distortion_jacobian(lens.terms, plane);
        const double determinant = xx * yy - cross * cross;
        plane.x -= (yy * ex - cross * ey) / determinant;
        plane.y -= (xx * ey - cross * ex) / determinant;
    }
    // Between the pixels that st_check_camera tries a wild lens may have no inverse.
    return error < LARGEST_ERROR ? plane : Point{NAN, NAN};
}

Flow image_flow(const Lens &lens, const Point &plane) {
    const double a = plane.x, b = plane.y;
    const auto [xx, cross, yy] = distortion_jacobian(lens.terms, plane);
    double c = 1.0, h = 1.0;
    const double theta2 = a * a + b * b;
    if (lens.equidistant && theta2 > 0) {
        const double theta = std::sqrt(theta2);
        c = theta / std::tan(theta);
        h = (1 - c) / theta2;
    }
    const double da[3] = {h * a * b, -(c + h * a * a), b};
    const double db[3] = {c + h * b * b, -h * a * b, -a};
    Flow flow;
    for (int axis = 0; axis < 3; ++axis) {
        flow[0][axis] = lens.fx * (xx * da[axis] + cross * db[axis]);
        flow[1][axis] = lens.fy * (cross * da[axis] + yy * db[axis]);
    }
    return flow;
}

double corner_angle(const Lens &lens) {
    const double right = lens.width - 0.5, bottom = lens.height - 0.5;
    const Point corners[4] = {{-0.5, -0.5}, {right, -0.5}, {-0.5, bottom}, {right, bottom}};
    double least = 1.0;
    for (const Point &corner : corners) {
        const double cosine = unproject(lens, corner)[2];
        if (std::isnan(cosine)) {
            return lens.farthest_rad;
        }
        least = cosine < least ? cosine : least;
    }
    return std::acos(least);
}

Quaternion middle_axes(const Lens &lens) {
    const Point middle = {(lens.width - 1) / 2.0, (lens.height - 1) / 2.0};
    return quaternion_from_axes(unproject(lens, middle),
                                unproject(lens, {middle.x, middle.y + 1}));
}

}  // namespace st

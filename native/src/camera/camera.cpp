// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Cameras of the C interface: what no camera can have is refused, and lists of pixels.

#include <cfloat>
#include <cmath>

#include "camera/lens.h"
#include "startracker.h"

namespace st {
namespace {

constexpr double LARGEST_SIDE_PX = 65536;
constexpr double PLANAR_LIMIT_DEG = 85;
constexpr int COEFFICIENTS[ST_LENS_MODEL_COUNT] = {5, 8, 4};
// An equidistant lens that folds beyond this angle has an image circle; else its terms are wrong.
constexpr double CIRCLE_RAD = 65 * M_PI / 180;
constexpr double LARGEST_ERROR = 1e-9;  // of an inverse, in focal lengths
constexpr int GRID = 8;                 // intervals along each side of the image

/// Whether least <= value <= most; fills the fault otherwise.
bool within(const char *name, double value, double least, double most, st_fault *fault) {
    if (value >= least && value <= most) {
        return true;
    }
    if (fault != nullptr) {
        *fault = {name, value, least, most};
    }
    return false;
}

bool numbers_are_possible(const st_camera &camera, st_fault *fault) {
    const double most = LARGEST_SIDE_PX, largest = DBL_MAX;
    bool possible = within("width_px", camera.width_px, 1, most, fault) &&
                    within("height_px", camera.height_px, 1, most, fault) &&
                    within("fx_px", camera.fx_px, DBL_MIN, largest, fault) &&
                    within("fy_px", camera.fy_px, DBL_MIN, largest, fault) &&
                    within("cx_px", camera.cx_px, -most, camera.width_px + most, fault) &&
                    within("cy_px", camera.cy_px, -most, camera.height_px + most, fault) &&
                    within("model", camera.model, 0, ST_LENS_MODEL_COUNT - 1, fault);
    for (int i = 0; possible && i < 8; ++i) {
        const double limit = i < COEFFICIENTS[camera.model] ? largest : 0.0;
        possible = within("distortion", camera.distortion[i], -limit, limit, fault);
    }
    return possible;
}

/// Whether the field of view, without distortion, is one that the model can have. Pixels beyond the
/// image circle of an equidistant lens have no direction.
bool field_is_possible(const Lens &lens, st_fault *fault) {
    if (lens.equidistant) {
        return true;
    }
    const double edges[4] = {(-0.5 - lens.cx) / lens.fx, (lens.width - 0.5 - lens.cx) / lens.fx,
                             (-0.5 - lens.cy) / lens.fy, (lens.height - 0.5 - lens.cy) / lens.fy};
    for (const double edge : edges) {
        const double angle_deg = std::atan(edge) * 180 / M_PI;
        if (!within("field of view to one side, deg", angle_deg, -PLANAR_LIMIT_DEG,
                    PLANAR_LIMIT_DEG, fault)) {
            return false;
        }
    }
    return true;
}

/// Set the lens of a camera for a call with these arrays; ST_OK unless one of them is not possible.
st_status lens_for(const st_camera *camera, const double *from, const double *to, Lens &lens) {
    if (camera == nullptr || from == nullptr || to == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!numbers_are_possible(*camera, nullptr)) {
        return ST_OUT_OF_RANGE;
    }
    lens = lens_of(*camera);
    return ST_OK;
}

}  // namespace

bool image_does_not_fold(const Lens &lens, st_fault *fault) {
    const bool circle = lens.equidistant && lens.farthest_rad >= CIRCLE_RAD;
    for (int i = 0; i <= GRID * (GRID + 2); ++i) {
        const int column = i % (GRID + 1), line = i / (GRID + 1);
        const Point pixel = {column * (lens.width - 1.0) / GRID,
                             line * (lens.height - 1.0) / GRID};
        const Point plane = undistorted(lens, pixel);
        if (circle && std::isnan(plane.x)) {
            continue;
        }
        const Point again = distort(lens.terms, plane);
        const double error = std::fmax(std::fabs(again.x - (pixel.x - lens.cx) / lens.fx),
                                       std::fabs(again.y - (pixel.y - lens.cy) / lens.fy));
        const auto [xx, cross, yy] = distortion_jacobian(lens.terms, plane);
        const double determinant = xx * yy - cross * cross;
        if (!(error < LARGEST_ERROR && determinant > 0)) {
            // NaN where there is no inverse at all.
            return within("distortion, which folds the image over itself: determinant",
                          error < LARGEST_ERROR ? determinant : NAN, DBL_MIN, DBL_MAX, fault);
        }
    }
    return true;
}

}  // namespace st

using namespace st;

extern "C" {

st_status st_check_camera(const st_camera *camera, st_fault *fault) {
    if (camera == nullptr) {
        return ST_NULL_POINTER;
    }
    if (!numbers_are_possible(*camera, fault)) {
        return ST_OUT_OF_RANGE;
    }
    const Lens lens = lens_of(*camera);
    return field_is_possible(lens, fault) && image_does_not_fold(lens, fault) ? ST_OK
                                                                              : ST_BAD_CAMERA;
}

st_status st_project(const st_camera *camera, const double *direction, double *pixel,
                     size_t count) {
    Lens lens;
    if (const st_status status = lens_for(camera, direction, pixel, lens); status != ST_OK) {
        return status;
    }
    for (size_t i = 0; i < count; ++i) {
        const double *d = direction + 3 * i;
        const Point found = project(lens, {{d[0], d[1], d[2]}});
        pixel[2 * i] = found.x;
        pixel[2 * i + 1] = found.y;
    }
    return ST_OK;
}

st_status st_unproject(const st_camera *camera, const double *pixel, double *direction,
                       size_t count) {
    Lens lens;
    if (const st_status status = lens_for(camera, pixel, direction, lens); status != ST_OK) {
        return status;
    }
    for (size_t i = 0; i < count; ++i) {
        const Vector3 found = unproject(lens, {pixel[2 * i], pixel[2 * i + 1]});
        for (int k = 0; k < 3; ++k) {
            direction[3 * i + static_cast<size_t>(k)] = found[k];
        }
    }
    return ST_OK;
}

st_status st_image_flow(const st_camera *camera, const double *direction, double *flow,
                        size_t count) {
    Lens lens;
    if (const st_status status = lens_for(camera, direction, flow, lens); status != ST_OK) {
        return status;
    }
    for (size_t i = 0; i < count; ++i) {
        const double *d = direction + 3 * i;
        const Point plane = plane_point(lens.equidistant, {{d[0], d[1], d[2]}});
        Flow found = {{{NAN, NAN, NAN}, {NAN, NAN, NAN}}};
        if (!std::isnan(pixel_of(lens, plane).x)) {
            found = image_flow(lens, plane);
        }
        for (size_t k = 0; k < 6; ++k) {
            flow[6 * i + k] = found.row[k / 3][k % 3];
        }
    }
    return ST_OK;
}

}  // extern "C"

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "kernels_blind.h"

#include <algorithm>

#include "blind/few_stars.h"
#include "blind/lens_fit.h"
#include "blind/quads.h"

using namespace st;

extern "C" {

int32_t stt_quad_code(const double *direction, const int32_t *four, double *code) {
    Code found{};
    const bool is_code = quad_code(reinterpret_cast<const Vector3 *>(direction), four, found);
    std::copy_n(found.element, 4, code);
    return is_code ? 1 : 0;
}

double stt_few_star_probability(int32_t n, int32_t m, int32_t j, int32_t k, int32_t stars,
                                double square, double order, double width, double height,
                                double scale_error) {
    return few_star_probability({n, m, j, k, stars, square, order, width, height}, scale_error);
}

void stt_linearised(const st_camera *camera, const double *quaternion, const double *change,
                    const double *icrf, int32_t parameters, double *pixel, double *partial) {
    Parameters by{};
    std::copy_n(change, MOST_PARAMETERS, by.element);
    const double *q = quaternion;
    const LensView view = changed({lens_of(*camera), {q[0], q[1], q[2], q[3]}}, by);
    const Lens &lens = view.lens;
    const Vector3 sensor =
        sensor_direction(matrix_from_quaternion(view.q), {{icrf[0], icrf[1], icrf[2]}});
    const Point plane = plane_point(lens.equidistant, sensor), at = pixel_of(lens, plane);
    const Matrix<2, MOST_PARAMETERS> H = derivatives(lens, plane, at, parameters);
    pixel[0] = at.x;
    pixel[1] = at.y;
    std::copy_n(&H.row[0][0], 2 * MOST_PARAMETERS, partial);
}

}  // extern "C"

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "blind/lens_fit.h"

#include <algorithm>
#include <cmath>

#include "maths/sorting.h"

namespace st {
namespace {

constexpr int STEPS = 3;           // of Gauss and Newton for each association
constexpr double SMALL_PX = 1e-3;  // a smaller change is the last
constexpr double LEAST_ERROR_PX = 0.1;
constexpr double TAIL = 9.0;  // of the weights, in variances: of a t-distribution

/// Return the weight of a residual of this square.
double weight_of(double square, double variance) {
    return 1 / (variance * (1 + square / (TAIL * variance)));
}

/// Return the parameters of a lens relative to those of another, d being zero.
Parameters drift(const Lens &lens, const Lens &start, int parameters) {
    const Terms &t = lens.terms, &s = start.terms;
    const double a = std::log(lens.fx / start.fx);
    Parameters found{{0.0, 0.0, 0.0, a, std::log(lens.fy / start.fy) - a,
                      (lens.cx - start.cx) / start.width, (lens.cy - start.cy) / start.width,
                      t.k1 - s.k1, t.k2 - s.k2, t.k3 - s.k3, t.k4 - s.k4}};
    for (int k = parameters; k < MOST_PARAMETERS; ++k) {
        found[k] = 0.0;
    }
    return found;
}

/// Return the error per axis of residuals of these squares, 0 for none; they change their order.
double error_of(double *square, int count) {
    if (count == 0) {
        return 0.0;
    }
    // For two axes the median is 2 ln 2 variances; few stars have hardly any freedom left.
    const double freedom = std::fmax(1 - 4.0 / (2 * count), 0.2);
    return std::sqrt(median(square, count) / (2 * M_LN2) / freedom);
}

/// Set what the prior tells of the parameters of a lens.
void set_prior(const LensPrior &prior, const Lens &lens, ParameterMatrix &information,
               Parameters &gradient) {
    const Parameters off = drift(lens, prior.start, prior.parameters);
    information = identity<MOST_PARAMETERS>();
    const int alone = lens.equidistant ? std::min(prior.parameters, RADIAL + 1) : prior.parameters;
    for (int k = 0; k < alone; ++k) {
        information[k][k] = 1 / (prior.free[k] * prior.free[k]);
        gradient[k] = -off[k] * information[k][k];
    }
    const ProjectionTail family = tail_of_projection(lens.terms.k1);
    const double term[3] = {lens.terms.k2, lens.terms.k3, lens.terms.k4};
    for (int k = alone; k < prior.parameters; ++k) {
        const double residual = term[k - alone] - family.term[k - alone];
        const double slope = family.slope[k - alone];
        const double weight = weight_of(residual * residual, prior.free[k] * prior.free[k]);
        information[k][k] = weight;
        information[RADIAL][k] = -weight * slope;
        information[RADIAL][RADIAL] += weight * slope * slope;
        gradient[k] = -weight * residual;
        gradient[RADIAL] += weight * slope * residual;
    }
}

/// Add what a star tells of the parameters, the upper triangle of the information.
void add_star(const Matrix<2, MOST_PARAMETERS> &partial, const Point &residual, double weight,
              ParameterMatrix &information, Parameters &gradient) {
    for (int j = 0; j < MOST_PARAMETERS; ++j) {
        const double along = weight * partial[0][j], across = weight * partial[1][j];
        gradient[j] += along * residual.x + across * residual.y;
        for (int k = j; k < MOST_PARAMETERS; ++k) {
            information[j][k] += along * partial[0][k] + across * partial[1][k];
        }
    }
}

}  // namespace

ProjectionTail tail_of_projection(double k1) {
    // Coefficients of k1^2, k1^3 and k1^4 in the series of the sine and of the tangent.
    constexpr double SINE[3] = {3.0 / 10, 3.0 / 70, 1.0 / 280};
    constexpr double TANGENT[3] = {6.0 / 5, 51.0 / 35, 62.0 / 35};
    const double *series = k1 < 0 ? SINE : TANGENT;
    ProjectionTail family{};
    double power = k1;
    for (int n = 0; n < 3; ++n) {
        family.slope[n] = (n + 2) * series[n] * power;
        power *= k1;
        family.term[n] = series[n] * power;
    }
    return family;
}

LensView changed(const LensView &view, const Parameters &change) {
    Lens lens = view.lens;
    const double a = change[3], b = change[4];
    lens.fx *= std::exp(a);
    lens.fy *= std::exp(a + b);
    lens.cx += lens.width * change[5];
    lens.cy += lens.width * change[6];
    Terms &t = lens.terms;
    t.k1 += change[RADIAL];
    t.k2 += change[RADIAL + 1];
    t.k3 += change[RADIAL + 2];
    t.k4 += change[RADIAL + 3];
    lens.distorted = t.k1 != 0 || t.k2 != 0 || t.p1 != 0 || t.p2 != 0 || t.k3 != 0 || t.k4 != 0 ||
                     t.d1 != 0 || t.d2 != 0 || t.d3 != 0;
    lens.farthest_rad = farthest_angle(lens.equidistant, t);
    return {lens, turned(view.q, first<3>(change))};
}

Matrix<2, MOST_PARAMETERS> derivatives(const Lens &lens, const Point &plane, const Point &pixel,
                                       int parameters) {
    Matrix<2, MOST_PARAMETERS> partial{};
    set_block(partial, 0, 0, image_flow(lens, plane));
    partial[0][3] = pixel.x - lens.cx;
    partial[1][3] = partial[1][4] = pixel.y - lens.cy;
    partial[0][5] = partial[1][6] = lens.width;
    const double square = plane.x * plane.x + plane.y * plane.y;
    double power = square;
    for (int k = RADIAL; k < parameters; ++k) {
        partial[0][k] = lens.fx * plane.x * power;
        partial[1][k] = lens.fy * plane.y * power;
        power *= square;
    }
    return partial;
}

void fit_lens(const LensPrior &prior, const SkyAndSpots &seen, const int32_t *star, double *square,
              LensFit &fit) {
    for (int step = 0; step < STEPS; ++step) {
        const Matrix3 R = matrix_from_quaternion(fit.view.q);
        int count = 0;
        for (int i = 0; i < seen.spots; ++i) {
            if (star[i] >= 0) {
                const Point pixel =
                    project(fit.view.lens, sensor_direction(R, seen.direction[star[i]]));
                const double du = seen.spot[i].x - pixel.x, dv = seen.spot[i].y - pixel.y;
                square[count] = du * du + dv * dv;
                // A star that has left the image of this lens is of no use for the next one.
                count += !std::isnan(square[count]);
            }
        }
        fit.error_px = error_of(square, count);
        ParameterMatrix information{};
        Parameters gradient{};
        set_prior(prior, fit.view.lens, information, gradient);
        for (int i = 0; i < seen.spots; ++i) {
            if (star[i] < 0) {
                continue;
            }
            const Lens &lens = fit.view.lens;
            const Point plane =
                plane_point(lens.equidistant, sensor_direction(R, seen.direction[star[i]]));
            const Point pixel = pixel_of(lens, plane);
            const Point residual{seen.spot[i].x - pixel.x, seen.spot[i].y - pixel.y};
            const double distance2 = residual.x * residual.x + residual.y * residual.y;
            if (std::isnan(distance2)) {
                continue;
            }
            const double sigma = seen.sigma_px[i];
            const double variance = std::fmax(sigma * sigma + LEAST_ERROR_PX * LEAST_ERROR_PX,
                                              fit.error_px * fit.error_px);
            add_star(derivatives(lens, plane, pixel, prior.parameters), residual,
                     weight_of(distance2, variance), information, gradient);
        }
        for (int j = 0; j < MOST_PARAMETERS; ++j) {
            for (int k = 0; k < j; ++k) {
                information[j][k] = information[k][j];
            }
        }
        double determinant = 0.0;
        fit.P = inverse_and_determinant(information, determinant);
        const Parameters change = fit.P * gradient;
        fit.view = changed(fit.view, change);
        const double turn =
            std::fmax(std::fabs(change[0]), std::fmax(std::fabs(change[1]), std::fabs(change[2])));
        if (turn * fit.view.lens.fx < SMALL_PX) {
            break;
        }
    }
}

double least_cosine(const Lens &lens) {
    const double angle = corner_angle(lens);
    if (std::isfinite(angle)) {
        return std::cos(angle);
    }
    Lens ideal = lens;
    ideal.terms = {};
    ideal.distorted = false;
    return std::cos(corner_angle(ideal));
}

Point pixel_in_image(const Lens &lens, double least, const Vector3 &sensor) {
    const Point outside{NAN, NAN};
    if (sensor[2] < least) {
        return outside;
    }
    const Point distorted = distort(lens.terms, plane_point(lens.equidistant, sensor));
    const Point pixel{lens.fx * distorted.x + lens.cx, lens.fy * distorted.y + lens.cy};
    return shows(lens, pixel) ? pixel : outside;
}

}  // namespace st

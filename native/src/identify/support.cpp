// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/support.h"

#include <cmath>

namespace st {
namespace {

// Of orders with 0 to 3 inversions: the logarithms of 6, 2, 6 / 5 and 1.
constexpr double ORDER_SUPPORT[4] = {1.791759469228055, 0.6931471805599453, 0.1823215567939546,
                                     0.0};

// Of a candidate that none of so many supports, the others are not looked up: of ten true ones among
// thirty image stars it would be one in thirty.
constexpr int FIRST_LOOKED_UP = 8;

double order_support(const int32_t base[3], int32_t first, int32_t second, int32_t third) {
    const int inversions = ((base[0] < base[1]) != (first < second)) +
                           ((base[0] < base[2]) != (first < third)) +
                           ((base[1] < base[2]) != (second < third));
    return ORDER_SUPPORT[inversions];
}

}  // namespace

Supporters supporters(int32_t catalogue_stars, const ImageStars &stars, const int32_t base[3],
                      double tolerance_sigmas) {
    const Vector3 *image = stars.direction;
    Supporters found{};
    double variance[3];
    // Rows b x c, c x a, a x b over a . (b x c): their products with star i are its weights.
    Vector3 dual[3];
    const double whole = dot(image[base[0]], cross(image[base[1]], image[base[2]]));
    for (int k = 0; k < 3; ++k) {
        const Vector3 normal = cross(image[base[(k + 1) % 3]], image[base[(k + 2) % 3]]);
        dual[k] = {{normal[0] / whole, normal[1] / whole, normal[2] / whole}};
        found.base[k] = base[k];
        variance[k] = stars.sigma[base[k]] * stars.sigma[base[k]];
    }
    // Beyond, a star is there by chance.
    const double farthest = 2 / std::sqrt(static_cast<double>(catalogue_stars));
    for (int i = 0; i < stars.count; ++i) {
        if (i == base[0] || i == base[1] || i == base[2]) {
            continue;
        }
        Vector3 weight;
        double square = stars.sigma[i] * stars.sigma[i];
        for (int k = 0; k < 3; ++k) {
            weight[k] = dot(image[i], dual[k]);
            square += weight[k] * weight[k] * variance[k];
        }
        const double radius = tolerance_sigmas * std::sqrt(square);
        const bool has_place = found.count < MOST_SUPPORTERS;
        if (!(radius < (has_place ? farthest : found.reach[MOST_SUPPORTERS - 1]))) {
            continue;
        }
        int row = has_place ? found.count++ : MOST_SUPPORTERS - 1;
        for (; row > 0 && found.reach[row - 1] > radius; --row) {
            found.reach[row] = found.reach[row - 1];
            found.weight[row] = found.weight[row - 1];
        }
        found.reach[row] = radius;
        found.weight[row] = weight;
    }
    for (int i = 0; i < found.count; ++i) {
        found.gain[i] = 2 * std::log(farthest / found.reach[i]);
        found.sum += found.gain[i];
    }
    return found;
}

double support(const Patterns &sky, const Supporters &stars, int32_t first, int32_t second,
               int32_t third, double enough) {
    const int32_t three[3] = {first, second, third};
    const double order = order_support(stars.base, first, second, third);
    double found = 0.0, left = stars.sum;
    for (int i = 0; i < stars.count && found + left > enough - order; ++i) {
        if (i == FIRST_LOOKED_UP && found == 0) {
            break;
        }
        left -= stars.gain[i];
        if (is_supported(sky.cells, sky.direction, stars, i, three)) {
            found += stars.gain[i];
        }
    }
    return found > 0 ? found + order : 0.0;
}

}  // namespace st

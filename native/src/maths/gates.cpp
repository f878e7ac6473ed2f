// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "maths/gates.h"

#include <cmath>

namespace st {
namespace {

constexpr int TERMS = 100, MOST_STEPS = 20;
constexpr double HALF_LOG_TWO_PI = 0.91893853320467274178;
constexpr double LEAST_FOR_SERIES = 10.0;

/// Return the logarithm of the gamma function for a > 0: Stirling's series at a + n, and
/// gamma(a) = gamma(a + n) / (a (a + 1) ... (a + n - 1)) (Abramowitz and Stegun, 6.1.41).
///
/// lgamma() of the C library sets a global variable.
double log_gamma(double a) {
    double product = 1.0;
    while (a < LEAST_FOR_SERIES) {
        product *= a;
        a += 1;
    }
    const double s = 1 / (a * a);
    const double series =
        (1.0 / 12 -
         s * (1.0 / 360 -
              s * (1.0 / 1260 - s * (1.0 / 1680 - s * (1.0 / 1188 - s * 691.0 / 360360))))) /
        a;
    return (a - 0.5) * std::log(a) - a + HALF_LOG_TWO_PI + series - std::log(product);
}

}  // namespace

double gate(double probability, double dof) {
    const double a = dof / 2;
    double x = dof;
    for (int step = 0; step < MOST_STEPS; ++step) {
        const double half = x / 2;
        double fraction = half + 2 * TERMS + 1 - a;
        for (int n = TERMS; n > 0; --n) {
            fraction = half + 2 * n - 1 - a - n * (n - a) / fraction;
        }
        const double log_tail = a * std::log(half) - half - log_gamma(a) - std::log(fraction);
        // d log Q / dx is -fraction / x.
        const double change = (log_tail - std::log(probability)) * x / fraction;
        x += change;
        if (std::fabs(change) <= 1e-13 * x) {
            break;
        }
    }
    return x;
}

}  // namespace st

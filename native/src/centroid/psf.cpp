// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/psf.h"

namespace st {
namespace {

constexpr int Z_MAX = 6;   // beyond this Phi is 0 or 1
constexpr int STEPS = 32;  // nodes of the tables per standard deviation
constexpr int NODES = 2 * Z_MAX * STEPS + 1;

struct Node {
    double phi, density;  // Phi and phi
};

struct Table {
    Node node[NODES];
};

/// Return exp(x) for -18 <= x <= 0: the series of exp(x / 64), squared six times.
constexpr long double exponential(long double x) {
    long double term = 1, total = 1;
    for (int k = 1; k < 18; ++k) {
        term *= x / 64 / k;
        total += term;
    }
    for (int k = 0; k < 6; ++k) {
        total *= total;
    }
    return total;
}

/// Phi(z) = 1/2 + phi(z) (z + z^3 / 3 + z^5 / (3 5) + ...) (Abramowitz and Stegun, 26.2.11), in
/// more digits than are stored, so that the lower tail has enough of them.
constexpr Table table() {
    constexpr long double PER_DENSITY = 2.50662827463100050241577L;  // sqrt(2 pi)
    Table table{};
    for (int k = 0; k <= Z_MAX * STEPS; ++k) {
        const long double z = static_cast<long double>(k) / STEPS;
        const long double density = exponential(-z * z / 2) / PER_DENSITY;
        long double term = z, total = z;
        for (int n = 3; term > total * 1e-21L; n += 2) {
            term *= z * z / n;
            total += term;
        }
        const long double half = density * total;
        table.node[Z_MAX * STEPS + k] = {static_cast<double>(0.5L + half),
                                         static_cast<double>(density)};
        table.node[Z_MAX * STEPS - k] = {static_cast<double>(0.5L - half),
                                         static_cast<double>(density)};
    }
    return table;
}

constexpr Table TABLE = table();

}  // namespace

template <class Number>
void profile(double centre, double sigma, int first, int count, Profile<Number> &of) {
    const double per_sigma = 1 / sigma, z_first = (first - 0.5 - centre) / sigma;
    double z_lower = 0.0, density_lower = 0.0, phi_lower = 0.0;
    for (int k = 0; k <= count; ++k) {
        double z = z_first + k * per_sigma;
        // As it is written NaN becomes a bound, which is in the table.
        z = z > -Z_MAX ? z : -Z_MAX;
        z = z < Z_MAX ? z : Z_MAX;
        const int nearest = static_cast<int>((z + Z_MAX) * STEPS + 0.5);
        const Node node = TABLE.node[nearest];
        const double z0 = nearest * (1.0 / STEPS) - Z_MAX, t = z - z0, square = z0 * z0;
        const double phi =
            node.phi + node.density * t * (1 - t * (z0 / 2 - t * ((square - 1) / 6)));
        const double density =
            node.density * (1 - t * (z0 - t * ((square - 1) / 2 - t * (z0 * (square - 3) / 6))));
        if (k > 0) {
            of.share[k - 1] = static_cast<Number>(phi - phi_lower);
            of.d_centre[k - 1] = static_cast<Number>((density_lower - density) * per_sigma);
            of.d_sigma[k - 1] =
                static_cast<Number>((z_lower * density_lower - z * density) * per_sigma);
        }
        z_lower = z;
        density_lower = density;
        phi_lower = phi;
    }
}

template void profile(double, double, int, int, Profile<float> &);
template void profile(double, double, int, int, Profile<double> &);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/psf.h"

#include "maths/lanes.h"

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
constexpr int EDGES = MOST_COLUMNS + PAIR;
constexpr double SIXTH = 1.0 / 6;
constexpr Pair LOWEST{-Z_MAX, -Z_MAX}, HIGHEST{Z_MAX, Z_MAX};

}  // namespace

template <class Number>
void profile(double centre, double sigma, int first, int count, Profile<Number> &of) {
    // At the edges of the pixels, two at a time.
    double z[EDGES], phi[EDGES], density[EDGES];
    const double per_sigma = 1 / sigma, z_first = (first - 0.5 - centre) / sigma;
    for (int k = 0; k <= count; k += PAIR) {
        Pair here = z_first + Pair{1.0 * k, k + 1.0} * per_sigma;
        // As it is written NaN becomes a bound, which is in the table.
        here = here > LOWEST ? here : LOWEST;
        here = here < HIGHEST ? here : HIGHEST;
        const Pair place = (here + Z_MAX) * STEPS + 0.5;
        const int one = static_cast<int>(place[0]), other = static_cast<int>(place[1]);
        const Node node = TABLE.node[one], next = TABLE.node[other];
        const Pair phi0{node.phi, next.phi}, density0{node.density, next.density};
        const Pair z0 = Pair{1.0 * one, 1.0 * other} * (1.0 / STEPS) - Z_MAX;
        const Pair t = here - z0, square = z0 * z0;
        store(z + k, here);
        store(phi + k, phi0 + density0 * t * (1 - t * (z0 * 0.5 - t * ((square - 1) * SIXTH))));
        store(density + k,
              density0 *
                  (1 - t * (z0 - t * ((square - 1) * 0.5 - t * (z0 * (square - 3) * SIXTH)))));
    }
    for (int k = 0; k < count; ++k) {
        of.share[k] = static_cast<Number>(phi[k + 1] - phi[k]);
        of.d_centre[k] = static_cast<Number>((density[k] - density[k + 1]) * per_sigma);
        of.d_sigma[k] =
            static_cast<Number>((z[k] * density[k] - z[k + 1] * density[k + 1]) * per_sigma);
    }
}

template void profile(double, double, int, int, Profile<float> &);
template void profile(double, double, int, int, Profile<double> &);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/false_alarm.h"

#include <cmath>

namespace st {
namespace {

// Matched stars, the brightest, whose order is tested.
constexpr int ORDERED = 12;
constexpr int MOST_INVERSIONS = ORDERED * (ORDERED - 1) / 2;

/// The share of the permutations of n things with at most k inversions.
struct Shares {
    double of[ORDERED + 1][MOST_INVERSIONS + 1];
};

constexpr Shares permutation_shares() {
    Shares shares{};
    double density[MOST_INVERSIONS + 1]{};
    density[0] = 1.0;
    for (int n = 0; n <= ORDERED; ++n) {
        // The n-th thing comes before 0 .. n - 1 of the others.
        double next[MOST_INVERSIONS + 1]{};
        for (int k = 0; n >= 2 && k <= MOST_INVERSIONS; ++k) {
            for (int before = 0; before < n && before <= k; ++before) {
                next[k] += density[k - before] / n;
            }
        }
        double sum = 0.0;
        for (int k = 0; k <= MOST_INVERSIONS; ++k) {
            if (n >= 2) {
                density[k] = next[k];
            }
            sum += density[k];
            // All of them, whatever the sum rounds to.
            const bool all = 2 * k >= n * (n - 1);
            shares.of[n][k] = all || sum > 1.0 ? 1.0 : sum;
        }
    }
    return shares;
}

constexpr Shares SHARES = permutation_shares();

}  // namespace

int occupied_cells(const ImageStars &stars, const int32_t *star, double area, int across,
                   bool *brightest, Arena &work) {
    const Arena::Scope scope(work);
    const double edge = std::sqrt(area) / across;
    auto *cell = work.take<Point>(static_cast<size_t>(stars.count));
    int cells = 0;
    for (int i = 0; i < stars.count; ++i) {
        cell[i] = {std::floor(stars.seen[i].x / edge), std::floor(stars.seen[i].y / edge)};
        bool is_new = true;
        brightest[i] = star[i] >= 0;
        for (int j = 0; j < i; ++j) {
            if (cell[j].x == cell[i].x && cell[j].y == cell[i].y) {
                is_new = false;
                brightest[i] = brightest[i] && !brightest[j];
            }
        }
        cells += is_new;
    }
    return cells;
}

double binomial_tail(int m, int n, double p) {
    if (m <= 0 || p >= 1) {
        return 1.0;
    }
    // Relative to the largest term, which is near n p: far from it they are less than any number.
    const int mode = static_cast<int>((n + 1) * p), largest = mode < n ? mode : n;
    double total = 0.0, tail = 0.0, term = 1.0;
    for (int k = largest; k <= n; ++k) {
        total += term;
        tail += k >= m ? term : 0.0;
        term *= static_cast<double>(n - k) / (k + 1) * p / (1 - p);
    }
    term = 1.0;
    for (int k = largest - 1; k >= 0; --k) {
        term *= static_cast<double>(k + 1) / (n - k) * (1 - p) / p;
        total += term;
        tail += k >= m ? term : 0.0;
    }
    return tail / total;
}

double order_probability(const int32_t *star, const bool *chosen, int count) {
    int32_t ordered[ORDERED];
    int found = 0, inversions = 0;
    for (int i = 0; i < count && found < ORDERED; ++i) {
        if (!chosen[i]) {
            continue;
        }
        for (int j = 0; j < found; ++j) {
            inversions += ordered[j] > star[i];
        }
        ordered[found++] = star[i];
    }
    return SHARES.of[found][inversions];
}

double residual_probability(const double *residual, int count, double radius, int base) {
    int matched = 0;
    double x = 0.0;
    for (int i = 0; i < count; ++i) {
        if (residual[i] >= 0) {
            ++matched;
            x += (residual[i] / radius) * (residual[i] / radius);
        }
    }
    double bound = 1.0;
    for (int k = 0; k < matched - base; ++k) {
        bound *= x / (k + 1);
    }
    return bound < 1.0 ? bound : 1.0;
}

double fisher_combined(double product) {
    const double log = product > 0 ? -std::log(product) : 0.0;
    return product * (1 + log + log * log / 2 + log * log * log / 6);
}

int least_matches(int n, double p, double share, int base, double tolerance_sigmas, double tested,
                  double most) {
    double order = 1.0;
    for (int m = 1; m <= n; ++m) {
        order /= m < ORDERED ? m : ORDERED;
        if (m <= base) {
            continue;
        }
        const double mean = 2 * m / (tolerance_sigmas * tolerance_sigmas);
        const double x = mean < 1.0 ? mean : 1.0;
        double bound = 1.0;
        for (int k = 0; k < m - base; ++k) {
            bound *= x / (k + 1);
        }
        const double product = binomial_tail(m - base, n - base, p) * share * order * bound;
        if (tested * fisher_combined(product) <= most) {
            return m;
        }
    }
    return n + 1;
}

}  // namespace st

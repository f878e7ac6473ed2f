// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/blur.h"

#include <cmath>

#include "centroid/smoothing.h"
#include "maths/clones.h"

namespace st {
namespace {

constexpr double REACH_SIGMAS = 4.0;
constexpr int MOST_RADIUS = 16;

ST_CLONES void set_weighted(const float *__restrict from, float weight, int count,
                            float *__restrict to) {
    for (int x = 0; x < count; ++x) {
        to[x] = weight * from[x];
    }
}

ST_CLONES void add_weighted(const float *before, const float *after, float weight, int count,
                            float *__restrict to) {
    for (int x = 0; x < count; ++x) {
        to[x] += weight * (before[x] + after[x]);
    }
}

}  // namespace

void blur(const Plane<float> &plane, double sigma_px, Arena &arena) {
    const Arena::Scope scope(arena);
    const int width = plane.width, height = plane.height;
    const int radius = static_cast<int>(std::nearbyint(2 * REACH_SIGMAS * sigma_px + 1)) / 2;
    double side[MOST_RADIUS + 1], sum = 0.0;
    float weights[MOST_RADIUS + 1] = {};
    for (int k = 0; k <= radius; ++k) {
        side[k] = std::exp(-0.5 / (sigma_px * sigma_px) * k * k);
        sum += k == 0 ? side[k] : 2 * side[k];
    }
    for (int k = 0; k <= radius; ++k) {
        weights[k] = static_cast<float>(side[k] / sum);
    }
    // The rows about the one that is written, after the filter along them.
    const int kept = 2 * radius + 1;
    auto *rows = arena.take<float>(static_cast<size_t>(width) * static_cast<size_t>(kept));
    const auto across = [=](int v) { return rows + static_cast<ptrdiff_t>(v % kept) * width; };
    auto *line = arena.take<float>(static_cast<size_t>(width + 2 * radius));
    for (int below = 0; below < height + radius; ++below) {
        if (below < height) {
            const float *row = plane.row(below);
            float *filtered = across(below);
            for (int x = 0; x < width + 2 * radius; ++x) {
                line[x] = row[mirrored(x - radius, width)];
            }
            set_weighted(line + radius, weights[0], width, filtered);
            for (int k = 1; k <= radius; ++k) {
                add_weighted(line + radius - k, line + radius + k, weights[k], width, filtered);
            }
        }
        const int v = below - radius;
        if (v >= 0) {
            float *row = plane.row(v);
            set_weighted(across(v), weights[0], width, row);
            for (int k = 1; k <= radius; ++k) {
                add_weighted(across(mirrored(v - k, height)), across(mirrored(v + k, height)),
                             weights[k], width, row);
            }
        }
    }
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/windows.h"

#include <cmath>

#include "maths/sorting.h"

namespace st {
namespace {

int greater_of(int a, int b) {
    return a > b ? a : b;
}

int lesser_of(int a, int b) {
    return a < b ? a : b;
}

}  // namespace

int Window::pixels_used() const {
    Lanes total{};
    for (int k = 0; k < area(); k += LANES) {
        total += load(used + k);
    }
    return static_cast<int>(sum(total));
}

int window_radius(double sigma_px) {
    const double radius = std::ceil(RADIUS_SIGMAS * sigma_px);
    return radius > LEAST_RADIUS_PX
               ? radius < MOST_RADIUS_PX ? static_cast<int>(radius) : MOST_RADIUS_PX
               : LEAST_RADIUS_PX;
}

void cut_window(const Frame &frame, const Peak &peak, int radius, Window &window) {
    const Image &image = frame.image;
    const int count = 2 * radius + 1, filled = (count + LANES - 1) / LANES * LANES;
    const int left = peak.u - radius, top = peak.v - radius;
    const double noise = peak.noise / frame.kernel.noise_gain;
    window.count = count;
    window.filled = filled;
    window.left = left;
    window.top = top;
    window.variance = noise * noise;
    const Slope slope = slope_at(frame.mesh, peak.u, peak.v, radius);
    const int first_x = greater_of(-left, 0), end_x = lesser_of(image.width - left, count);
    const int first_y = greater_of(-top, 0), end_y = lesser_of(image.height - top, count);
    double across[MOST_COLUMNS];
    for (int x = 0; x < count; ++x) {
        across[x] = slope.across * (x - radius);
    }
    for (int y = 0; y < count; ++y) {
        float *data = window.data + window.row(y), *used = window.used + window.row(y);
        const bool inside = first_y <= y && y < end_y;
        for (int x = 0; x < filled; x += LANES) {
            if (!inside || x < first_x || x + LANES > end_x) {
                store(data + x, Lanes{});
                store(used + x, Lanes{});
            }
        }
        if (!inside) {
            continue;
        }
        const uint16_t *row = image.row(top + y) + left;
        const double down = slope.down * (y - radius);
        for (int x = first_x; x < end_x; ++x) {
            const double value = row[x];
            data[x] = static_cast<float>(value - peak.level - across[x] - down);
            used[x] = value < frame.full_scale_dn ? 1.0F : 0.0F;
        }
    }
}

bool lone_pixel(const Window &window) {
    const int middle = window.count / 2;
    const float here = window.data[middle * window.filled + middle];
    float around = -here;
    for (int y = middle - 1; y <= middle + 1; ++y) {
        for (int x = middle - 1; x <= middle + 1; ++x) {
            around += window.data[y * window.filled + x];
        }
    }
    return static_cast<double>(around) <= LONE_PIXEL * static_cast<double>(here);
}

int saturated_core(const Frame &frame, const Peak &peak) {
    const Image &image = frame.image;
    int count = 0;
    for (int v = peak.v - CORE_RADIUS_PX; v <= peak.v + CORE_RADIUS_PX; ++v) {
        for (int u = peak.u - CORE_RADIUS_PX; u <= peak.u + CORE_RADIUS_PX; ++u) {
            const bool inside = 0 <= u && u < image.width && 0 <= v && v < image.height;
            count += !(inside && image.at(u, v) < frame.full_scale_dn);
        }
    }
    return count;
}

Star initial_star(const Kernel &kernel, const Peak &peak, double sigma_px) {
    const double area = 2 * M_PI * (kernel.sigma_px * kernel.sigma_px + sigma_px * sigma_px);
    return {{peak.u + peak.top_u, peak.v + peak.top_v, peak.height * area, 0.0, sigma_px}};
}

Neighbours::Neighbours(const Pixel *corner, int count, int side_px, Arena &arena)
    : corner_(corner),
      count_(count),
      side_px_(side_px),
      order_(arena.take<int>(static_cast<size_t>(count))),
      place_(arena.take<int>(static_cast<size_t>(count))) {
    for (int i = 0; i < count; ++i) {
        order_[i] = i;
    }
    // place_ is the work memory until the order is known.
    sort(order_, count, place_, [corner](int a, int b) { return corner[a].v < corner[b].v; });
    for (int k = 0; k < count; ++k) {
        place_[order_[k]] = k;
    }
}

}  // namespace st

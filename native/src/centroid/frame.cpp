// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/frame.h"

namespace st {

Mesh mesh_of(const Image &image, const Kernel &kernel, bool has_hits, double *level, double *noise,
             Arena &arena) {
    Mesh mesh = measure_background(image, kernel, level, noise, arena);
    if (has_hits) {
        const double factor = pixel_noise(image, arena) * kernel.noise_gain / mesh.median_noise;
        for (int k = 0; k < mesh.size(); ++k) {
            noise[k] *= factor;
        }
        mesh.median_noise *= factor;
    }
    return mesh;
}

Frame prepare(const Image &image, double filter_sigma_px, const Threshold &threshold, int peaks,
              bool has_hits, Arena &arena) {
    Frame frame{};
    frame.image = image;
    frame.kernel = gaussian_kernel(filter_sigma_px);
    const size_t tiles = most_tiles(image.width, image.height);
    auto *level = arena.take<double>(tiles), *noise = arena.take<double>(tiles);
    frame.mesh = mesh_of(image, frame.kernel, has_hits, level, noise, arena);
    frame.search = find_peaks(image, frame.kernel, frame.mesh, threshold, peaks, arena);
    frame.full_scale_dn = full_scale(image, frame.search.row_max, frame.mesh.median_level);
    return frame;
}

bool is_blank(const Frame &frame) {
    const Image &image = frame.image;
    const uint16_t value = frame.search.row_max[0];
    for (int v = 0; v < image.height; ++v) {
        if (frame.search.row_max[v] != value) {
            return false;
        }
    }
    for (int v = 0; v < image.height; ++v) {
        for (int u = 0; u < image.width; ++u) {
            if (image.row(v)[u] != value) {
                return false;
            }
        }
    }
    return true;
}

bool is_saturated(const Frame &frame) {
    const Image &image = frame.image;
    int count = 0;
    for (int v = 0; v < image.height; ++v) {
        if (frame.search.row_max[v] == frame.full_scale_dn) {
            for (int u = 0; u < image.width; ++u) {
                count += image.row(v)[u] == frame.full_scale_dn ? 1 : 0;
            }
        }
    }
    return 2 * static_cast<int64_t>(count) > image.size();
}

}  // namespace st

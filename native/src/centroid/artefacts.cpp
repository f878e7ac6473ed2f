// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/artefacts.h"

#include <cmath>
#include <cstring>

#include "centroid/connected.h"
#include "centroid/hits.h"

namespace st {
namespace {

constexpr int LARGE_PX = 120;  // across; the longest streak of a star is shorter
constexpr int LARGE_PEAKS =
    30;  // on lines and discs, from which on these are taken out as a whole
constexpr double LARGE_SIGMAS = 3.0;  // above the background
constexpr int MARGIN_PX = 3;          // around something large, where its flux falls below that
constexpr double MOST_SHARE = 0.6;    // of the image; more is no artefact in a field of stars

struct Box {
    int left, right, top, bottom;

    bool is_large() const { return right - left >= LARGE_PX || bottom - top >= LARGE_PX; }
};

/// Number the connected bright pixels of an image; return how many spots there are.
int connect_bright(const Image &image, const Mesh &mesh, double noise_dn,
                   const Plane<int32_t> &spot, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *line = arena.take<float>(static_cast<size_t>(image.width));
    OverImage level(mesh, mesh.level, image.width, image.height, arena);
    const auto above = static_cast<float>(LARGE_SIGMAS * noise_dn);
    for (int v = 0; v < image.height; ++v) {
        level.fill(v, line);
        for (int u = 0; u < image.width; ++u) {
            spot.at(u, v) = static_cast<float>(image.row(v)[u]) > line[u] + above ? 1 : 0;
        }
    }
    return connect(spot, arena);
}

/// Replace the numbers of large spots by 1, of others by 0; return whether there is a large one.
bool keep_large(const Plane<int32_t> &spot, int count, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *boxes = arena.take<Box>(static_cast<size_t>(count) + 1);
    for (int i = 0; i <= count; ++i) {
        boxes[i] = {spot.width, 0, spot.height, 0};
    }
    for (int v = 0; v < spot.height; ++v) {
        for (int u = 0; u < spot.width; ++u) {
            Box &box = boxes[spot.at(u, v)];
            box.left = u < box.left ? u : box.left;
            box.right = u > box.right ? u : box.right;
            box.top = v < box.top ? v : box.top;
            box.bottom = v > box.bottom ? v : box.bottom;
        }
    }
    bool any = false;
    for (int i = 1; i <= count; ++i) {
        any |= boxes[i].is_large();
    }
    for (int k = 0; k < spot.size(); ++k) {
        const int number = spot.value[k];
        spot.value[k] = number != 0 && boxes[number].is_large() ? 1 : 0;
    }
    return any;
}

/// Fill mask with 1 within MARGIN_PX of a pixel that is not 0, along both axes; return how many.
int64_t widen(const Plane<int32_t> &large, const Plane<uint8_t> &mask) {
    // Along the rows, in place; then down the columns.
    for (int v = 0; v < large.height; ++v) {
        int32_t *row = large.row(v);
        int last = -1;  // pixel of something large
        for (int u = 0; u < large.width; ++u) {
            if (row[u] == 1) {
                for (int x = u - MARGIN_PX > last ? u - MARGIN_PX : last + 1; x < u; ++x) {
                    if (x >= 0) {
                        row[x] = 2;
                    }
                }
                last = u;
            } else if (last >= 0 && u - last <= MARGIN_PX) {
                row[u] = 2;
            }
        }
    }
    int64_t count = 0;
    for (int v = 0; v < large.height; ++v) {
        uint8_t *row = mask.row(v);
        std::memset(row, 0, static_cast<size_t>(large.width));
        for (int y = v - MARGIN_PX; y <= v + MARGIN_PX; ++y) {
            if (y >= 0 && y < large.height) {
                for (int u = 0; u < large.width; ++u) {
                    row[u] = large.row(y)[u] != 0 ? 1 : row[u];
                }
            }
        }
        for (int u = 0; u < large.width; ++u) {
            count += row[u];
        }
    }
    return count;
}

/// Take connected bright pixels that extend over LARGE_PX out of an image, whose pixels are clean.
void remove_large(const Image &image, uint16_t *clean, const Mesh &mesh, double noise_dn,
                  Arena &arena) {
    const Arena::Scope scope(arena);
    const auto size = static_cast<size_t>(image.size());
    const Plane<int32_t> spot{arena.take<int32_t>(size), image.width, image.height};
    const int count = connect_bright(image, mesh, noise_dn, spot, arena);
    if (!keep_large(spot, count, arena)) {
        return;
    }
    const Plane<uint8_t> mask{arena.take<uint8_t>(size), image.width, image.height};
    if (static_cast<double>(widen(spot, mask)) > MOST_SHARE * image.size()) {
        return;
    }
    auto *line = arena.take<float>(static_cast<size_t>(image.width));
    OverImage level(mesh, mesh.level, image.width, image.height, arena);
    for (int v = 0; v < image.height; ++v) {
        level.fill(v, line);
        for (int u = 0; u < image.width; ++u) {
            if (mask.at(u, v) != 0) {
                const float value = std::nearbyint(line[u]);
                clean[v * image.stride + u] = static_cast<uint16_t>(value < 0.0f       ? 0.0f
                                                                    : value < 65535.0f ? value
                                                                                       : 65535.0f);
            }
        }
    }
}

}  // namespace

Contamination find_contamination(const Frame &frame) {
    const Search &search = frame.search;
    const int large =
        search.lines.count + search.lines.left_out + search.discs.count + search.discs.left_out;
    return {search.too_many() || is_storm(frame.image, search.peaks), large >= LARGE_PEAKS};
}

Image cleaned(const Image &image, const Mesh &mesh, const Contamination &contamination,
              double sigma_px, Rejections &rejections, Arena &arena) {
    const double noise_dn = pixel_noise(image, arena);
    auto *clean = arena.take<uint16_t>(static_cast<size_t>(image.size()));
    for (int v = 0; v < image.height; ++v) {
        std::memcpy(clean + static_cast<ptrdiff_t>(v) * image.width, image.row(v),
                    sizeof(uint16_t) * static_cast<size_t>(image.width));
    }
    const Image view{clean, image.width, image.height, image.width, image.bits};
    if (contamination.large) {
        remove_large(view, clean, mesh, noise_dn, arena);
    }
    if (contamination.hits) {
        remove_hits(view, clean, mesh, noise_dn, sigma_px, rejections, arena);
    }
    return view;
}

}  // namespace st

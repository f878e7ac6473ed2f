// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/artefacts.h"

#include <cmath>
#include <cstring>

#include "centroid/connected.h"
#include "centroid/hits.h"
#include "maths/clones.h"

namespace st {
namespace {

constexpr int LARGE_PX = 120;    // across; the longest streak of a star is shorter
constexpr int LARGE_PEAKS = 30;  // on lines and discs, from which on these are removed as a whole
constexpr double LARGE_SIGMAS = 3.0;  // above the background
constexpr int MARGIN_PX = 3;          // around something large, where its flux falls below that
constexpr double MOST_SHARE = 0.6;    // of the image; more is not an artefact in a field of stars

bool is_large(const Box &box) {
    return box.right - box.left >= LARGE_PX || box.bottom - box.top >= LARGE_PX;
}

ST_CLONES void join(const uint8_t *__restrict from, int count, uint8_t *__restrict to) {
    for (int u = 0; u < count; ++u) {
        to[u] |= from[u];
    }
}

/// Add the bright pixels of an image to spots; return how many there are.
int connect_bright(const Image &image, const Mesh &mesh, double noise_dn, Connected &spots,
                   Arena &arena) {
    const Arena::Scope scope(arena);
    auto *value = arena.take<float>(static_cast<size_t>(image.width));
    auto *limit = arena.take<float>(static_cast<size_t>(image.width));
    const auto above = static_cast<float>(LARGE_SIGMAS * noise_dn);
    OverImage level(mesh, mesh.level, image.width, image.height, arena);
    for (int v = 0; v < image.height; ++v) {
        level.fill(v, limit);
        for (int u = 0; u < image.width; ++u) {
            value[u] = static_cast<float>(image.row(v)[u]);
            limit[u] += above;
        }
        spots.add_row(value, limit);
    }
    return spots.number();
}

/// Fill mask with 1 for the pixels of large ones of count spots, else 0; return whether there is a
/// large one.
bool mark_large(const Connected &spots, int count, const Plane<uint8_t> &mask, Arena &arena) {
    const Arena::Scope scope(arena);
    auto *boxes = arena.take<Box>(static_cast<size_t>(count));
    for (int i = 0; i < count; ++i) {
        boxes[i] = {};
    }
    for (int v = 0; v < spots.height(); ++v) {
        for (const Run &run : spots.row(v)) {
            boxes[run.spot - 1].add(run, v);
        }
    }
    bool any = false;
    std::memset(mask.value, 0, static_cast<size_t>(mask.size()));
    for (int v = 0; v < spots.height(); ++v) {
        for (const Run &run : spots.row(v)) {
            if (is_large(boxes[run.spot - 1])) {
                std::memset(mask.row(v) + run.first, 1,
                            static_cast<size_t>(run.last - run.first + 1));
                any = true;
            }
        }
    }
    return any;
}

/// Fill wide with 1 within MARGIN_PX of a pixel of mask, along both axes; return how many these
/// are. What was in mask is lost.
int64_t widen(const Plane<uint8_t> &mask, const Plane<uint8_t> &wide, Arena &arena) {
    const Arena::Scope scope(arena);
    const auto width = static_cast<size_t>(mask.width);
    auto *line = arena.take<uint8_t>(width + 2 * MARGIN_PX);
    std::memset(line, 0, width + 2 * MARGIN_PX);
    for (int v = 0; v < mask.height; ++v) {
        std::memcpy(line + MARGIN_PX, mask.row(v), width);
        for (int k = 0; k <= 2 * MARGIN_PX; ++k) {
            join(line + k, mask.width, mask.row(v));
        }
    }
    int64_t count = 0;
    for (int v = 0; v < mask.height; ++v) {
        uint8_t *row = wide.row(v);
        std::memset(row, 0, width);
        const int first = v - MARGIN_PX > 0 ? v - MARGIN_PX : 0;
        for (int y = first; y <= v + MARGIN_PX && y < mask.height; ++y) {
            join(mask.row(y), mask.width, row);
        }
        for (int u = 0; u < mask.width; ++u) {
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
    Connected spots(image.width, image.height, arena);
    const int count = connect_bright(image, mesh, noise_dn, spots, arena);
    const Plane<uint8_t> mask{arena.take<uint8_t>(size), image.width, image.height};
    const Plane<uint8_t> wide{arena.take<uint8_t>(size), image.width, image.height};
    if (!mark_large(spots, count, mask, arena) ||
        static_cast<double>(widen(mask, wide, arena)) > MOST_SHARE * image.size()) {
        return;
    }
    auto *line = arena.take<float>(static_cast<size_t>(image.width));
    OverImage level(mesh, mesh.level, image.width, image.height, arena);
    for (int v = 0; v < image.height; ++v) {
        level.fill(v, line);
        for (int u = 0; u < image.width; ++u) {
            if (wide.at(u, v) != 0) {
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

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/detection.h"

#include <cmath>

#include "maths/clones.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr int PX_PER_PEAK =
    400;                        // of more peaks than one in so many pixels the highest are listed
constexpr int FEW_PEAKS = 100;  // all of which are listed
constexpr double ROUNDING = 1e-6;    // relative, of a mean in float
constexpr int PLATEAU_DN = 64;       // a flat top lower than this may be rounding, not saturation
constexpr double RING_SIGMAS = 4.0;  // radius of a ring around a peak
constexpr double RING_LIGHT = 0.5;   // share of a peak's height from which on the ring is bright
constexpr int HALF_RING = 4;         // directions, and as many opposite ones

/// What a peak belongs to.
enum class Kind { STAR, DISC, LINE };

/// Detection threshold, in DN of the smoothed image.
///
/// tile has a value per tile of the mesh, at_tile (columns + 2) those of one row, at the middles of
/// the tiles. Segment j of a row, of columns + 1, is between the middles of tiles j and j + 1, where
/// the threshold is a straight line: pixels begin[j] to begin[j + 1] - 1. margin is the median
/// height of the threshold above the level.
struct Limits {
    double *tile, *at_tile;
    int *begin;
    int segments;
    double margin;
};

/// Ring buffers of a search down the image; row v is at v modulo their length. image (2 r + 1, W);
/// down (3, W + 2 r): filtered along the columns, r px longer on each side. smooth (3, W) is not a
/// ring: rows v - 1, v, v + 1 filtered along both axes, where needed.
struct Rows {
    float *image[2 * MOST_WEIGHTS];
    float *down[3];
    float *smooth[3];
};

double larger(double a, double b) {
    return a > b ? a : b;
}

Limits limits_of(const Mesh &mesh, const Threshold &threshold, int width, Arena &arena) {
    const int tiles = mesh.columns + 2;
    Limits limits{arena.take<double>(static_cast<size_t>(mesh.size())),
                  arena.take<double>(static_cast<size_t>(tiles)),
                  arena.take<int>(static_cast<size_t>(tiles)), tiles - 1,
                  larger(threshold.sigmas * mesh.median_noise, threshold.dn)};
    for (int k = 0; k < mesh.size(); ++k) {
        limits.tile[k] = mesh.level[k] + larger(threshold.sigmas * mesh.noise[k], threshold.dn);
    }
    limits.begin[0] = 1;
    for (int j = 1; j < tiles; ++j) {
        const double middle = std::ceil((j - 0.5) / mesh.tiles_across - 0.5);
        limits.begin[j] = middle < width - 1 ? static_cast<int>(middle) : width - 1;
    }
    return limits;
}

/// Copy a row of the image; return its brightest pixel.
ST_CLONES uint16_t load_row(const uint16_t *__restrict row, int width, float *__restrict copy) {
    uint16_t brightest = 0;
    for (int u = 0; u < width; ++u) {
        copy[u] = static_cast<float>(row[u]);
        brightest = row[u] > brightest ? row[u] : brightest;
    }
    return brightest;
}

/// Whether in count values from line on one reaches least + margin, or the mean of two neighbours
/// least - below. One comparison does both: a pixel is added to its neighbour, which counts as no
/// less than what a pixel of least + margin needs next to it.
ST_CLONES bool may_reach(const float *line, int count, double least, double margin, double below) {
    least -= ROUNDING * std::fabs(least);
    const auto pair = static_cast<float>(2 * (least - below));
    const auto beside = static_cast<float>(static_cast<double>(pair) - (least + margin));
    int reached = line[count - 1] + beside >= pair ? 1 : 0;
    for (int k = 0; k < count - 1; ++k) {
        const float following = line[k + 1];
        reached |= line[k] + (following > beside ? following : beside) >= pair ? 1 : 0;
    }
    return reached != 0;
}

/// Whether one of values begin .. end - 1 is at least lowest.
ST_CLONES bool reaches(const float *line, int begin, int end, float lowest) {
    int reached = 0;
    for (int k = begin; k < end; ++k) {
        reached |= line[k] >= lowest ? 1 : 0;
    }
    return reached != 0;
}

double lower_end(const Limits &limits, int j) {
    return limits.at_tile[j] < limits.at_tile[j + 1] ? limits.at_tile[j] : limits.at_tile[j + 1];
}

/// Fill chosen with the segments of a row in which a star may be; return their number.
///
/// line is the row filtered along its columns. The filter along the row is a mean of means of pairs,
/// with the share P = kernel.pairs, and of single pixels. Where all pixels are below T + margin and
/// all means of pairs below T - margin (1 - P) / P, T the lower end of the threshold in the segment,
/// the filtered row is below T: it need not be computed.
int find_segments(const float *line, const Kernel &kernel, const Limits &limits, int *chosen) {
    const int count = limits.segments, reach = 2 * kernel.radius;
    const int *begin = limits.begin;
    const double below = limits.margin * (1 - kernel.pairs) / kernel.pairs;
    double lowest = limits.at_tile[0];
    for (int j = 0; j < count; ++j) {
        lowest = limits.at_tile[j + 1] < lowest ? limits.at_tile[j + 1] : lowest;
    }
    // Most rows of a dark sky end here.
    if (!may_reach(line + begin[0], begin[count] + reach - begin[0], lowest, limits.margin,
                   below)) {
        return 0;
    }
    int found = 0;
    for (int j = 0; j < count; ++j) {
        chosen[found] = j;
        found += may_reach(line + begin[j], begin[j + 1] + reach - begin[j], lower_end(limits, j),
                           limits.margin, below)
                     ? 1
                     : 0;
    }
    return found;
}

/// Whether the middle row has a local maximum at u. It exceeds the four neighbours before it and
/// does not fall below the four after it, so that a flat top gives one peak.
bool is_maximum(const float *const *smooth, int u) {
    const float *above = smooth[0] + u, *row = smooth[1] + u, *below = smooth[2] + u;
    const float here = *row;
    return here > row[-1] && here >= row[1] && here > above[-1] && here > above[0] &&
           here > above[1] && here >= below[-1] && here >= below[0] && here >= below[1];
}

/// Fill maxima with the columns of the peaks in segment j of a row; return their number.
int find_maxima(const float *const *smooth, const Limits &limits, int j, double tiles_per_px,
                int *maxima) {
    const double left = limits.at_tile[j], right = limits.at_tile[j + 1];
    const auto lowest = static_cast<float>(lower_end(limits, j));
    int count = 0;
    for (int u = limits.begin[j]; u < limits.begin[j + 1]; ++u) {
        if (smooth[1][u] >= lowest) {
            const double x = (u + 0.5) * tiles_per_px + 0.5 - j;
            if (static_cast<double>(smooth[1][u]) > (1 - x) * left + x * right &&
                is_maximum(smooth, u)) {
                maxima[count++] = u;
            }
        }
    }
    return count;
}

/// Whether the filtered image exceeds the limit at the pixel in it next to u, v.
bool exceeds(const Image &image, const Kernel &kernel, int u, int v, double limit) {
    u = u < 0 ? 0 : u < image.width ? u : image.width - 1;
    v = v < 0 ? 0 : v < image.height ? v : image.height - 1;
    return filtered_at(image, kernel, u, v) > limit;
}

/// Return what a peak belongs to, by a ring of the filtered image around it: a DISC has half of the
/// ring or more above the limit, a LINE two opposite directions.
Kind kind_of(const Image &image, const Kernel &kernel, int u, int v, double limit,
             const Pixel *half_ring) {
    int bright = 0;
    bool opposite = false;
    for (int k = 0; k < HALF_RING; ++k) {
        const Pixel &at = half_ring[k];
        const bool here = exceeds(image, kernel, u + at.u, v + at.v, limit);
        const bool across = exceeds(image, kernel, u - at.u, v - at.v, limit);
        opposite |= here && across;
        bright += (here ? 1 : 0) + (across ? 1 : 0);
    }
    return bright >= HALF_RING ? Kind::DISC : opposite ? Kind::LINE : Kind::STAR;
}

/// Whether a peak comes ahead of another one: it is higher, or as high and earlier in the image.
bool precedes(const Peak &a, const Peak &b) {
    if (a.height != b.height) {
        return a.height > b.height;
    }
    return a.v != b.v ? a.v < b.v : a.u < b.u;
}

/// Insert a peak into a list of the highest: a heap, the last of them first (Williams, Commun. ACM
/// 7, 1964).
void keep_highest(List<Peak> &peaks, const Peak &peak) {
    int slot = peaks.count;
    if (peaks.count < peaks.capacity) {
        ++peaks.count;
        for (; slot > 0 && precedes(peaks[(slot - 1) / 2], peak); slot = (slot - 1) / 2) {
            peaks[slot] = peaks[(slot - 1) / 2];
        }
        peaks[slot] = peak;
        return;
    }
    ++peaks.left_out;
    if (peaks.capacity == 0 || !precedes(peak, peaks[0])) {
        return;
    }
    slot = 0;
    for (int child = 1; child < peaks.count; child = 2 * slot + 1) {
        if (child + 1 < peaks.count && precedes(peaks[child], peaks[child + 1])) {
            ++child;
        }
        if (!precedes(peak, peaks[child])) {
            break;
        }
        peaks[slot] = peaks[child];
        slot = child;
    }
    peaks[slot] = peak;
}

/// Put the peak at pixel u, v into the list that it belongs to.
void add_peak(const Image &image, const Kernel &kernel, const Mesh &mesh,
              const float *const *smooth, const Pixel *half_ring, int u, int v, Search &search) {
    const Background sky = background_at(mesh, u, v);
    const double here = static_cast<double>(smooth[1][u]), height = here - sky.level;
    switch (kind_of(image, kernel, u, v, sky.level + RING_LIGHT * height, half_ring)) {
        case Kind::DISC:
            search.discs.add({u, v});
            break;
        case Kind::LINE:
            search.lines.add({u, v});
            break;
        case Kind::STAR:
            ++search.found;
            keep_highest(search.peaks, {u, v,
                                        parabola_top(static_cast<double>(smooth[1][u - 1]), here,
                                                     static_cast<double>(smooth[1][u + 1])),
                                        parabola_top(static_cast<double>(smooth[0][u]), here,
                                                     static_cast<double>(smooth[2][u])),
                                        height, sky.level, sky.noise});
    }
}

/// Fill row_max and the lists of a search, the peaks as a heap.
void search_rows(const Image &image, const Kernel &kernel, const Mesh &mesh,
                 const Threshold &threshold, Search &search, Arena &arena) {
    const Arena::Scope scope(arena);
    const int width = image.width, height = image.height, radius = kernel.radius;
    const int rows_kept = 2 * radius + 1;
    Rows rows{};
    for (int k = 0; k < rows_kept; ++k) {
        rows.image[k] = arena.take<float>(static_cast<size_t>(width));
    }
    for (int k = 0; k < 3; ++k) {
        rows.down[k] = arena.take<float>(static_cast<size_t>(width + 2 * radius));
        rows.smooth[k] = arena.take<float>(static_cast<size_t>(width));
    }
    Pixel half_ring[HALF_RING];
    for (int k = 0; k < HALF_RING; ++k) {
        const double angle = k * (M_PI / 4), px = RING_SIGMAS * kernel.sigma_px;
        half_ring[k] = {static_cast<int>(std::nearbyint(px * std::cos(angle))),
                        static_cast<int>(std::nearbyint(px * std::sin(angle)))};
    }
    const Limits limits = limits_of(mesh, threshold, width, arena);
    int *segments = arena.take<int>(static_cast<size_t>(limits.segments + 1));
    int *maxima = arena.take<int>(static_cast<size_t>(width));
    for (int below = -radius; below < height; ++below) {
        if (below + radius < height) {
            search.row_max[below + radius] = load_row(image.row(below + radius), width,
                                                      rows.image[(below + radius) % rows_kept]);
        }
        if (below < 0) {
            continue;
        }
        const float *of_filter[2 * MOST_WEIGHTS];
        for (int k = 0; k < rows_kept; ++k) {
            of_filter[k] = rows.image[mirrored(below + k - radius, height) % rows_kept];
        }
        filter_down(of_filter, kernel, width, rows.down[below % 3]);
        if (below < 2) {
            continue;
        }
        const int v = below - 1;
        interpolate_row(mesh, limits.tile, (v + 0.5) * mesh.tiles_down + 0.5, limits.at_tile);
        const float *line = rows.down[v % 3];
        const int count = find_segments(line, kernel, limits, segments);
        for (int k = 0; k < count; ++k) {
            const int j = segments[k], first = limits.begin[j], end = limits.begin[j + 1];
            filter_across(line, kernel, first - 1, end + 1, rows.smooth[1]);
            if (!reaches(rows.smooth[1], first, end, static_cast<float>(lower_end(limits, j)))) {
                continue;
            }
            filter_across(rows.down[(v - 1) % 3], kernel, first - 1, end + 1, rows.smooth[0]);
            filter_across(rows.down[below % 3], kernel, first - 1, end + 1, rows.smooth[2]);
            const int found = find_maxima(rows.smooth, limits, j, mesh.tiles_across, maxima);
            for (int m = 0; m < found; ++m) {
                add_peak(image, kernel, mesh, rows.smooth, half_ring, maxima[m], v, search);
            }
        }
    }
}

/// Whether one of the brightest pixels has four as bright next to it.
bool has_flat_top(const Image &image, const uint16_t *row_max, uint16_t brightest) {
    for (int v = 1; v < image.height - 1; ++v) {
        if (row_max[v - 1] != brightest || row_max[v] != brightest ||
            row_max[v + 1] != brightest) {
            continue;
        }
        const uint16_t *above = image.row(v - 1), *row = image.row(v), *below = image.row(v + 1);
        for (int u = 1; u < image.width - 1; ++u) {
            if (above[u] == brightest && below[u] == brightest && row[u - 1] == brightest &&
                row[u] == brightest && row[u + 1] == brightest) {
                return true;
            }
        }
    }
    return false;
}

}  // namespace

int most_peaks(int width, int height) {
    const int peaks = width * height / PX_PER_PEAK;
    return peaks > FEW_PEAKS ? peaks : FEW_PEAKS;
}

Search find_peaks(const Image &image, const Kernel &kernel, const Mesh &mesh,
                  const Threshold &threshold, int capacity, Arena &arena) {
    const auto most = static_cast<size_t>(capacity);
    Search search{arena.list<Peak>(most), arena.list<Pixel>(2 * most), arena.list<Pixel>(2 * most),
                  0, arena.take<uint16_t>(static_cast<size_t>(image.height))};
    search_rows(image, kernel, mesh, threshold, search, arena);
    const Arena::Scope scope(arena);
    sort(search.peaks.item, search.peaks.count, arena.take<Peak>(most), precedes);
    return search;
}

double full_scale(const Image &image, const uint16_t *row_max, double background_dn) {
    uint16_t brightest = 0;
    for (int v = 0; v < image.height; ++v) {
        brightest = row_max[v] > brightest ? row_max[v] : brightest;
    }
    if (brightest == (1 << image.bits) - 1) {
        return brightest;
    }
    if (brightest - background_dn < PLATEAU_DN) {
        return INFINITY;
    }
    for (int depth = 10; image.bits == 16 && depth <= 14; depth += 2) {
        const int full = (1 << depth) - 1;
        if (brightest == full || brightest == full << (image.bits - depth)) {
            return brightest;
        }
    }
    return has_flat_top(image, row_max, brightest) ? static_cast<double>(brightest) : INFINITY;
}

}  // namespace st

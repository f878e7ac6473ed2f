// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Local background and noise on a coarse mesh, measured in the smoothed image.

#pragma once

#include "centroid/image.h"
#include "centroid/smoothing.h"
#include "maths/arena.h"

namespace st {

constexpr int TILE_PX = 64;
constexpr int LEAST_TILE_PX = 8;  // tiles are halved down to this side at most

/// Background of an image; level and noise (rows + 2, columns + 2) have a value per tile.
///
/// One more tile on each side continues them linearly. level in DN; noise, 1 sigma in DN, is that
/// of the smoothed image. The medians are of the inner tiles. tiles_down and tiles_across are the
/// tiles per pixel.
struct Mesh {
    double *level, *noise;
    int rows, columns;
    double median_level, median_noise;
    double tiles_down, tiles_across;

    /// Elements of level and of noise.
    int size() const { return (rows + 2) * (columns + 2); }
};

struct Background {
    double level, noise;
};

struct Slope {
    double across, down;
};

/// Return the value of level or noise at y tiles down and x tiles across, bilinear.
inline double interpolate(const Mesh &mesh, const double *tile, double y, double x) {
    const int i = y < 1.0 ? 0 : y < mesh.rows ? static_cast<int>(y) : mesh.rows;
    const int j = x < 1.0 ? 0 : x < mesh.columns ? static_cast<int>(x) : mesh.columns;
    const double *above = tile + i * (mesh.columns + 2) + j, *below = above + mesh.columns + 2;
    y -= i;
    x -= j;
    return (1 - y) * ((1 - x) * above[0] + x * above[1]) + y * ((1 - x) * below[0] + x * below[1]);
}

/// Fill at_tile (columns + 2) with the values at y tiles down, in the middles of the tiles.
inline void interpolate_row(const Mesh &mesh, const double *tile, double y, double *at_tile) {
    const int i = y < 1.0 ? 0 : y < mesh.rows ? static_cast<int>(y) : mesh.rows;
    const double *above = tile + i * (mesh.columns + 2), *below = above + mesh.columns + 2;
    for (int j = 0; j < mesh.columns + 2; ++j) {
        at_tile[j] = (i + 1 - y) * above[j] + (y - i) * below[j];
    }
}

/// Return level and noise at a pixel, which may be beyond the borders.
inline Background background_at(const Mesh &mesh, int u, int v) {
    const double y = (v + 0.5) * mesh.tiles_down + 0.5, x = (u + 0.5) * mesh.tiles_across + 0.5;
    return {interpolate(mesh, mesh.level, y, x), interpolate(mesh, mesh.noise, y, x)};
}

/// Return the slopes of the level, across and down per px, over a window around a pixel.
inline Slope slope_at(const Mesh &mesh, int u, int v, int radius) {
    return {(background_at(mesh, u + radius, v).level - background_at(mesh, u - radius, v).level) /
                (2 * radius),
            (background_at(mesh, u, v + radius).level - background_at(mesh, u, v - radius).level) /
                (2 * radius)};
}

/// Elements of level and of noise of the finest mesh of an image.
size_t most_tiles(int width, int height);

/// Measure the mesh of an image after smoothing, into level and noise of most_tiles() elements:
/// median and scaled MAD of each tile.
///
/// The smoothed image is measured because averaging undoes the quantisation that makes the MAD of
/// an 8-bit image 0 or 1, and because correlated noise then counts with its effect on a star. Where
/// the noise is skewed, as in a camera whose background is cut off at zero, the MAD is scaled up to
/// the upper tail, which makes the false stars. Tiles are halved where the level is not a plane
/// between their middles, as in a glare: what it leaves would count as noise.
Mesh measure_background(const Image &image, const Kernel &kernel, double *level, double *noise,
                        Arena &arena);

/// Level or noise of a mesh at each pixel of its image: bilinear between the middles of the tiles,
/// constant beyond the outermost. Rows are filled in turn, with memory of the arena.
class OverImage {
public:
    OverImage(const Mesh &mesh, const double *tile, int width, int height, Arena &arena);

    /// Fill row v of the image, as wide as that.
    void fill(int v, float *row);

    /// Return the value at one pixel.
    float at(int u, int v) const;

private:
    /// A place between two tiles: the first of them, the second, and the share of the second.
    struct Between {
        int first, second;
        float share;
    };

    static Between between(int pixel, int pixels, int tiles);
    float across(int tile_row, const Between &place) const;

    const Mesh &mesh_;
    const double *tile_;
    int width_, height_;
    Between *places_;
    // Rows of tiles over the columns of the image: two of them are about any row of pixels.
    float *over_[2];
    int filled_[2] = {-1, -1};
};

/// Fill plane with an image less the level of its mesh.
void subtract_level(const Image &image, const Mesh &mesh, const Plane<float> &plane, Arena &arena);

/// Return the noise of a pixel, 1 sigma in DN, by the steps along its rows. Hits on some pixels
/// leave it as it is, while the filter gives each the size of a star.
double pixel_noise(const Image &image, Arena &arena);

/// Whether the level around many of the stars near places, count of them, is another one.
/// noise_dn is that of a pixel; the level around a star is the median of a ring.
bool has_changed(const Mesh &mesh, const Image &image, const Place *places, int count,
                 double noise_dn);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Views of images: the pixels of a camera, and numbers for each of them.

#pragma once

#include <cstddef>
#include <cstdint>

namespace st {

struct Pixel {
    int u, v;
};

/// A position in an image, px; (0, 0) is the centre of the top-left pixel.
struct Place {
    double u, v;
};

/// The pixels of a camera, DN. All are uint16, so that each function is compiled once; bits is
/// their depth as they came, 8 or 16. Row v begins at pixel + v * stride.
struct Image {
    const uint16_t *pixel;
    int width, height;
    ptrdiff_t stride;
    int bits;

    const uint16_t *row(int v) const { return pixel + v * stride; }
    int at(int u, int v) const { return pixel[v * stride + u]; }
    int size() const { return width * height; }
};

/// Copy count pixels of 8 bits.
void widen_row(const uint8_t *row, int count, uint16_t *copy);

/// A number for each pixel of an image, row after row without gaps.
template <class T>
struct Plane {
    T *value;
    int width, height;

    T *row(int v) const { return value + static_cast<ptrdiff_t>(v) * width; }
    T &at(int u, int v) const { return value[static_cast<ptrdiff_t>(v) * width + u]; }
    int size() const { return width * height; }
};

}  // namespace st

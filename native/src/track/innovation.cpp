// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/innovation.h"

namespace st {

/// z = sum beta_j z_j,  R = sum beta_j (R_j + z_j z_j^T) - z z^T (Bar-Shalom and Fortmann,
/// Tracking and Data Association, 1988, 6.4).
Innovation combined_innovation(const Point &predicted, const Places &centroids,
                               const Association &association, int track) {
    Innovation mixture{};
    auto &[z, R] = mixture;
    const double detected = 1 - association.missed[track];
    for (const Pairing *one = association.begin(track); one < association.end(track); ++one) {
        if (one->value > 0) {
            const double beta = one->value / detected;
            const Covariance2 &error = centroids.error[one->centroid];
            const double u = centroids.uv[one->centroid].x - predicted.x;
            const double v = centroids.uv[one->centroid].y - predicted.y;
            z.x += beta * u;
            z.y += beta * v;
            R.uu += beta * (error.uu + u * u);
            R.uv += beta * (error.uv + u * v);
            R.vv += beta * (error.vv + v * v);
        }
    }
    R.uu -= z.x * z.x;
    R.uv -= z.x * z.y;
    R.vv -= z.y * z.y;
    return mixture;
}

void NormalEquations3::add(const Flow &H, const Innovation &star, double weight) {
    if (weight == 0) {
        return;
    }
    const auto &[z, R] = star;
    const double scale = weight / determinant(R);
    const double uu = scale * R.vv, uv = -scale * R.uv, vv = scale * R.uu;
    for (int row = 0; row < 3; ++row) {
        const double u = H[0][row] * uu + H[1][row] * uv;
        const double v = H[0][row] * uv + H[1][row] * vv;
        vector[row] += u * z.x + v * z.y;
        for (int column = 0; column < 3; ++column) {
            information[row][column] += u * H[0][column] + v * H[1][column];
        }
    }
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "attitude/pointing.h"

namespace st {
namespace {

// A slower flow says nothing about a time.
constexpr double LEAST_FLOW_PX_S = 10.0;

}  // namespace

Matrix3 pointing_covariance(const Lens &lens, const Covariance2 &correlated,
                            const Vector3 *rate_rad_s) {
    Matrix<3, 2> turn{{{0.0, 1 / lens.fy}, {-1 / lens.fx, 0.0}, {0.0, 0.0}}};
    if (rate_rad_s != nullptr) {
        const Vector3 &w = *rate_rad_s;
        const Vector<2> flow{{-lens.fx * w[1], lens.fy * w[0]}};
        const double square = dot(flow, flow) + LEAST_FLOW_PX_S * LEAST_FLOW_PX_S;
        turn[2][0] = w[2] * flow[0] / square;
        turn[2][1] = w[2] * flow[1] / square;
    }
    const Matrix<2, 2> C{{{correlated.uu, correlated.uv}, {correlated.uv, correlated.vv}}};
    Matrix3 P = turn * C * transposed(turn);
    P[2][2] *= 2;
    return P;
}

bool correlated_error(const st_centroid *centroids, int count, Covariance2 &correlated) {
    const st_centroid *largest = nullptr;
    bool any = false;
    for (const st_centroid *one = centroids; one < centroids + count; ++one) {
        any = any || one->common_uu_px2 != 0 || one->common_uv_px2 != 0 || one->common_vv_px2 != 0;
        if (largest == nullptr || one->common_uu_px2 + one->common_vv_px2 >
                                      largest->common_uu_px2 + largest->common_vv_px2) {
            largest = one;
        }
    }
    if (any) {
        correlated = correlated_error_of(*largest);
    }
    return any;
}

}  // namespace st

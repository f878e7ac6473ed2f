// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "blind/quads.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace st {
namespace {

constexpr int CELLS_X = ST_QUAD_CELLS, CELLS_Y = 2 * CELLS_X;
constexpr int ORDERS = 4;

double squared_chord(const Vector3 &a, const Vector3 &b) {
    const Vector3 d = a - b;
    return dot(d, d);
}

double angle_of(double square) {
    return 2 * std::asin(std::fmin(std::sqrt(square) / 2, 1.0));
}

/// Whether noise of a tolerance lets a code be that of the order of its stars.
bool in_order(const Code &code, double tolerance) {
    return code[0] + code[2] <= 1 + 2 * tolerance && code[0] <= code[2] + 2 * tolerance;
}

/// Exchange A and B, or else C and D, of stars and their code.
void exchange(bool ends, int32_t four[4], Code &code) {
    if (ends) {
        std::swap(four[0], four[1]);
        code = {{1 - code[0], -code[1], 1 - code[2], -code[3]}};
    } else {
        std::swap(four[2], four[3]);
        code = {{code[2], code[3], code[0], code[1]}};
    }
}

int cell_x(double x) {
    return static_cast<int>(std::clamp(std::floor(x * CELLS_X), 0.0, CELLS_X - 1.0));
}

int cell_y(double y) {
    return static_cast<int>(std::clamp(std::floor((y + 1) / 2 * CELLS_Y), 0.0, CELLS_Y - 1.0));
}

/// Add the quads within a tolerance of a code, of a side between two limits; unit is the side that
/// has the ratio 1.
void look_up(const st_quad_table &table, const Code &code, double tolerance, double low,
             double high, double unit, const int32_t four[4], QuadList &found) {
    const int first_c = cell_y(code[1] - tolerance), last_c = cell_y(code[1] + tolerance);
    const int first_d = cell_y(code[3] - tolerance), last_d = cell_y(code[3] + tolerance);
    for (int i = cell_x(code[0] - tolerance); i <= cell_x(code[0] + tolerance); ++i) {
        for (int j = cell_x(code[2] - tolerance); j <= cell_x(code[2] + tolerance); ++j) {
            for (int k = first_c; k <= last_c; ++k) {
                // The cells along the last axis are consecutive.
                const int row = ((i * CELLS_X + j) * CELLS_Y + k) * CELLS_Y;
                const int32_t end = table.start[row + last_d + 1];
                for (int32_t q = table.start[row + first_d]; q < end; ++q) {
                    const double side = static_cast<double>(table.side_rad[q]);
                    bool fits = found.count < found.most && low <= side && side <= high;
                    for (int m = 0; fits && m < 4; ++m) {
                        const double of_sky =
                            static_cast<double>(table.code[4 * ptrdiff_t{q} + m]);
                        fits = std::fabs(of_sky - code[m]) <= tolerance;
                    }
                    if (fits) {
                        std::copy(four, four + 4, found.star + 4 * found.count);
                        found.row[found.count] = q;
                        found.ratio[found.count++] = side / unit;
                    }
                }
            }
        }
    }
}

}  // namespace

bool quad_code(const Vector3 *direction, const int32_t four[4], Code &code) {
    const Vector3 &a = direction[four[0]], &b = direction[four[1]];
    const Vector3 sum = a + b, difference = b - a;
    const double m = norm(sum), e = norm(difference);
    if (!(m > 0 && e > 0)) {
        return false;
    }
    const Vector3 middle = scaled(sum, 1 / m), along = scaled(difference, 1 / e);
    // The axis of y is at right angles to A B.
    const Vector3 across = cross(middle, along);
    const double length = e / (1 + m / 2);
    for (int k = 0; k < 2; ++k) {
        const Vector3 &s = direction[four[2 + k]];
        const double scale = 1 / ((1 + dot(s, middle)) * length);
        code[2 * k] = 0.5 + scale * dot(s, along);
        code[2 * k + 1] = scale * dot(s, across);
    }
    return true;
}

void match_quad(const st_quad_table &table, const Vector3 *direction, const int32_t stars[4],
                double tolerance, double low, double high, QuadList &found) {
    double square[4][4], longest = 0.0;
    for (int a = 0; a < 4; ++a) {
        for (int b = 0; b < a; ++b) {
            square[a][b] = squared_chord(direction[stars[a]], direction[stars[b]]);
            longest = std::fmax(longest, square[a][b]);
        }
    }
    for (int a = 0; a < 4; ++a) {
        for (int b = 0; b < a; ++b) {
            if (square[a][b] < longest * (1 - 2 * tolerance)) {
                continue;
            }
            int32_t four[4] = {stars[a], stars[b]};
            for (int c = 0, rest = 2; c < 4; ++c) {
                if (c != a && c != b) {
                    four[rest++] = stars[c];
                }
            }
            Code code{};
            if (!quad_code(direction, four, code)) {
                continue;
            }
            const double side = angle_of(square[a][b]);
            for (int order = 0; order < ORDERS; ++order) {
                exchange(order % 2 != 0, four, code);
                if (in_order(code, tolerance)) {
                    look_up(table, code, tolerance, low * side, high * side, side, four, found);
                }
            }
        }
    }
}

int make_quads(const QuadBuild &level, int32_t a, int32_t b, float *code, int32_t *star,
               float *side_rad) {
    const Vector3 *direction = level.direction;
    const double limit = squared_chord(direction[a], direction[b]);
    int32_t inner[ST_MOST_QUAD_INNER];
    int found = 0, count = 0;
    for (int32_t m = level.start[a]; m < level.start[a + 1] && found < level.most_inner; ++m) {
        const int32_t c = level.neighbour[m];
        if (squared_chord(direction[a], direction[c]) < limit &&
            squared_chord(direction[b], direction[c]) < limit) {
            inner[found++] = c;
        }
    }
    for (int i = 0; i < found; ++i) {
        for (int j = 0; j < i; ++j) {
            if (squared_chord(direction[inner[i]], direction[inner[j]]) >= limit) {
                continue;
            }
            int32_t four[4] = {a, b, inner[j], inner[i]};
            Code one{};
            bool ordered = quad_code(direction, four, one) && in_order(one, 0.0);
            for (int order = 1; !ordered && order < ORDERS; ++order) {
                exchange(order % 2 != 0, four, one);
                ordered = in_order(one, 0.0);
            }
            if (ordered) {
                for (int k = 0; k < 4; ++k) {
                    code[4 * count + k] = static_cast<float>(one[k]);
                    star[4 * count + k] = four[k];
                }
                side_rad[count++] = static_cast<float>(angle_of(limit));
            }
        }
    }
    return count;
}

}  // namespace st

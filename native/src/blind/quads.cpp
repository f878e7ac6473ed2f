// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "blind/quads.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "camera/lens.h"

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

// Look-ups that are made together: the memory of one is fetched while others are prepared.
constexpr int GROUP = 16;
constexpr ptrdiff_t LINE = 16;     // floats that a processor fetches at once
constexpr double ROUNDING = 1e-6;  // of single precision

/// A code that is looked up: the quads of a side from low to high rad; unit has the ratio 1.
struct LookUp {
    Code code;
    double low, high, unit;
    int32_t four[4];
};

void fetch(const float *first, const float *end) {
    for (const float *at = first; at < end; at += LINE) {
        __builtin_prefetch(at);
    }
    if (first < end) {
        __builtin_prefetch(end - 1);
    }
}

/// Look-ups of one table within one tolerance.
class LookUps {
public:
    LookUps(const st_quad_table &table, double tolerance, QuadList &found)
        : table_(table), tolerance_(tolerance), found_(found) {}

    void add(const LookUp &one) {
        group_[count_++] = one;
        visit_rows(one, [this](const int32_t *start, const int32_t *end) {
            __builtin_prefetch(start);
            __builtin_prefetch(end);
        });
        if (count_ == GROUP) {
            finish();
        }
    }

    /// Add what is found of the look-ups since the last call, in their order.
    void finish() {
        for (int i = 0; i < count_; ++i) {
            visit_rows(group_[i], [this](const int32_t *start, const int32_t *end) {
                fetch(table_.side_rad + *start, table_.side_rad + *end);
            });
        }
        for (int i = 0; i < count_; ++i) {
            visit_rows(group_[i], [this, i](const int32_t *start, const int32_t *end) {
                scan(group_[i], *start, *end);
            });
        }
        count_ = 0;
    }

private:
    /// Call visit(start, end) for the cells of each row that have codes within the tolerance.
    template <class Visit>
    void visit_rows(const LookUp &one, Visit visit) const {
        const Code &code = one.code;
        const int first_c = cell_y(code[1] - tolerance_), last_c = cell_y(code[1] + tolerance_);
        const int first_d = cell_y(code[3] - tolerance_), last_d = cell_y(code[3] + tolerance_);
        const int last_i = cell_x(code[0] + tolerance_), last_j = cell_x(code[2] + tolerance_);
        for (int i = cell_x(code[0] - tolerance_); i <= last_i; ++i) {
            for (int j = cell_x(code[2] - tolerance_); j <= last_j; ++j) {
                for (int k = first_c; k <= last_c; ++k) {
                    // The cells along the last axis are consecutive.
                    const int row = ((i * CELLS_X + j) * CELLS_Y + k) * CELLS_Y;
                    visit(table_.start + row + first_d, table_.start + row + last_d + 1);
                }
            }
        }
    }

    void scan(const LookUp &one, int32_t start, int32_t end) {
        // First in single precision, in a little more than the range: most quads are outside.
        const float *side_rad = table_.side_rad;
        const auto low = static_cast<float>(one.low * (1 - ROUNDING));
        const auto high = static_cast<float>(one.high * (1 + ROUNDING));
        const auto tolerance = static_cast<float>(tolerance_ + ROUNDING);
        const auto x = static_cast<float>(one.code[0]), y = static_cast<float>(one.code[1]);
        const auto z = static_cast<float>(one.code[2]), w = static_cast<float>(one.code[3]);
        for (int32_t q = start; q < end; ++q) {
            const int is_in_range =
                static_cast<int>(low <= side_rad[q]) & static_cast<int>(side_rad[q] <= high);
            if (is_in_range == 0) {
                continue;
            }
            const float *code = table_.code + 4 * ptrdiff_t{q};
            const int is_near = static_cast<int>(std::fabs(code[0] - x) <= tolerance) &
                                static_cast<int>(std::fabs(code[1] - y) <= tolerance) &
                                static_cast<int>(std::fabs(code[2] - z) <= tolerance) &
                                static_cast<int>(std::fabs(code[3] - w) <= tolerance);
            if (is_near != 0) {
                add_exact(one, q);
            }
        }
    }

    void add_exact(const LookUp &one, int32_t q) {
        const double side = static_cast<double>(table_.side_rad[q]);
        bool fits = one.low <= side && side <= one.high && found_.count < found_.most;
        for (int m = 0; fits && m < 4; ++m) {
            const double of_sky = static_cast<double>(table_.code[4 * ptrdiff_t{q} + m]);
            fits = std::fabs(of_sky - one.code[m]) <= tolerance_;
        }
        if (fits) {
            std::copy(one.four, one.four + 4, found_.star + 4 * found_.count);
            found_.row[found_.count] = q;
            found_.ratio[found_.count++] = side / one.unit;
        }
    }

    const st_quad_table &table_;
    double tolerance_;
    QuadList &found_;
    int count_ = 0;
    LookUp group_[GROUP];
};

/// A, B and the axes of their code.
struct Axes {
    Vector3 middle, along, across;
    double length;
};

bool axes_of(const Vector3 &a, const Vector3 &b, Axes &axes) {
    const Vector3 sum = a + b, difference = b - a;
    const double m = norm(sum), e = norm(difference);
    if (!(m > 0 && e > 0)) {
        return false;
    }
    axes.middle = scaled(sum, 1 / m);
    axes.along = scaled(difference, 1 / e);
    // The axis of y is at right angles to A B.
    axes.across = cross(axes.middle, axes.along);
    axes.length = e / (1 + m / 2);
    return true;
}

Point place_of(const Axes &axes, const Vector3 &s) {
    const double scale = 1 / ((1 + dot(s, axes.middle)) * axes.length);
    return {0.5 + scale * dot(s, axes.along), scale * dot(s, axes.across)};
}

/// Add the look-ups of four image stars, in any order that noise allows.
void match_quad(const Vector3 *direction, const int32_t stars[4], double tolerance, double low,
                double high, LookUps &look_ups) {
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
                    look_ups.add({code,
                                  low * side,
                                  high * side,
                                  side,
                                  {four[0], four[1], four[2], four[3]}});
                }
            }
        }
    }
}

/// Call visit(m) for the stars of all cells within a chord of a unit vector, by their places.
template <class Visit>
void visit_places(const QuadLevel &level, const Vector3 &centre, double chord, Visit visit) {
    any_place_near(level.cells, centre, chord, [&visit](int32_t m) {
        visit(m);
        return false;
    });
}

}  // namespace

bool quad_code(const Vector3 *direction, const int32_t four[4], Code &code) {
    Axes axes{};
    if (!axes_of(direction[four[0]], direction[four[1]], axes)) {
        return false;
    }
    const Point c = place_of(axes, direction[four[2]]), d = place_of(axes, direction[four[3]]);
    code = {{c.x, c.y, d.x, d.y}};
    return true;
}

void match_quads(const st_quad_table &table, const Vector3 *direction, const int32_t *quads,
                 size_t count, double tolerance, double low, double high, QuadList &found) {
    LookUps look_ups(table, tolerance, found);
    for (const int32_t *four = quads; four < quads + 4 * count; four += 4) {
        if (std::none_of(four, four + 4,
                         [direction](int32_t star) { return std::isnan(direction[star][0]); })) {
            match_quad(direction, four, tolerance, low, high, look_ups);
        }
    }
    look_ups.finish();
}

int32_t quad_cell(const float code[4]) {
    const auto wide = [code](int axis) { return static_cast<double>(code[axis]); };
    return ((cell_x(wide(0)) * CELLS_X + cell_x(wide(2))) * CELLS_Y + cell_y(wide(1))) * CELLS_Y +
           cell_y(wide(3));
}

void mark_alone(const QuadLevel &level, uint8_t *alone) {
    const double limit = level.crowd * level.crowd;
    const int32_t *rank = level.cells.member;
    std::fill(alone, alone + level.stars, uint8_t{1});
    for (size_t s = 0; s < level.stars; ++s) {
        visit_places(level, level.direction[s], level.crowd, [&](int32_t other) {
            if (rank[other] < rank[s] &&
                squared_chord(level.direction[other], level.direction[s]) <= limit) {
                alone[s] = 0;
            }
        });
    }
}

bool make_quads(const QuadLevel &level, int32_t m, const QuadWork &work, QuadsMade &made) {
    if (work.alone[m] == 0) {
        return true;
    }
    const Vector3 *direction = level.direction, &A = direction[m];
    const int32_t *rank = level.cells.member;
    const double shortest = level.side * level.side, longest = level.longest * level.longest;
    size_t near = 0;
    visit_places(level, A, level.longest, [&](int32_t other) {
        const double square = squared_chord(A, direction[other]);
        if (square <= longest && other != m && work.alone[other] != 0) {
            work.near[near] = other;
            work.by_rank[near] = (int64_t{rank[other]} << 32) | static_cast<int64_t>(near);
            work.square[near++] = square;
        }
    });
    if (made.count + near * (ST_MOST_QUAD_INNER * (ST_MOST_QUAD_INNER - 1) / 2) > made.most) {
        return false;
    }
    std::make_heap(work.by_rank, work.by_rank + near);
    std::sort_heap(work.by_rank, work.by_rank + near);
    for (size_t n = 0; n < near; ++n) {
        const Vector3 &B = direction[work.near[n]];
        const double limit = work.square[n];
        Axes axes{};
        if (rank[work.near[n]] < rank[m] || limit < shortest || !axes_of(A, B, axes)) {
            continue;
        }
        const auto side = static_cast<float>(angle_of(limit));
        int32_t inner[ST_MOST_QUAD_INNER];
        Point place[ST_MOST_QUAD_INNER];
        int found = 0;
        for (size_t k = 0; k < near && found < level.most_inner; ++k) {
            const int64_t one = work.by_rank[k] & INT32_MAX;
            const int32_t c = work.near[one];
            if (work.square[one] < limit && squared_chord(B, direction[c]) < limit) {
                place[found] = place_of(axes, direction[c]);
                inner[found++] = c;
            }
        }
        for (int i = 0; i < found; ++i) {
            for (int j = 0; j < i; ++j) {
                if (squared_chord(direction[inner[i]], direction[inner[j]]) >= limit) {
                    continue;
                }
                int32_t four[4] = {rank[m], rank[work.near[n]], rank[inner[j]], rank[inner[i]]};
                Code code{{place[j].x, place[j].y, place[i].x, place[i].y}};
                bool ordered = in_order(code, 0.0);
                for (int order = 1; !ordered && order < ORDERS; ++order) {
                    exchange(order % 2 != 0, four, code);
                    ordered = in_order(code, 0.0);
                }
                if (ordered) {
                    for (size_t k = 0; k < 4; ++k) {
                        made.code[4 * made.count + k] =
                            static_cast<float>(code[static_cast<int>(k)]);
                        made.star[4 * made.count + k] = four[k];
                    }
                    made.side_rad[made.count++] = side;
                }
            }
        }
    }
    return true;
}

}  // namespace st

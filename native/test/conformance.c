// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * conformance FOLDER: computes each case of the corpus test/conformance, whose README has the
 * layout, and prints every output that differs by more than its tolerance. Exit status 1 if any
 * does, 2 for a corpus that cannot be read.
 */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "json.h"
#include "kernels.h"
#include "sky_file.h"

/* ---- a case: inputs, and outputs that are compared ---- */

#define MOST_INPUTS 32

typedef struct {
    const char *stage, *name;
    const json *input, *output, *tolerance;
    int compared, differences, read;
    double *numbers[MOST_INPUTS];
} conformance_case;

/* Numbers of an input, as many as wanted, or any number for 0. They stay until the next case. */
static const double *input(conformance_case *one, const char *name, size_t wanted) {
    const json *value = json_member(one->input, name);
    size_t count = 0;
    double *numbers = value == NULL ? NULL : json_numbers(value, &count);
    if (numbers == NULL || one->read == MOST_INPUTS || (wanted != 0 && count != wanted)) {
        fprintf(stderr, "%s %s: input %s has %zu numbers, not %zu\n", one->stage, one->name, name,
                count, wanted);
        exit(2);
    }
    one->numbers[one->read++] = numbers;
    return numbers;
}

static size_t input_count(const conformance_case *one, const char *name) {
    const json *value = json_member(one->input, name);
    return value == NULL ? 0 : value->count;
}

/* How far found is from expected, over the tolerance; as difference() of golden_vectors.py. */
static double excess(const char *name, const double *expected, const double *found, size_t count,
                     const double tolerance[2]) {
    double largest = 0.0, away = 0.0, product = 0.0;
    for (size_t i = 0; i < count; ++i) {
        product += isnan(expected[i]) || isnan(found[i]) ? 0.0 : expected[i] * found[i];
    }
    const double sign = strstr(name, "quaternion") != NULL && product < 0 ? -1.0 : 1.0;
    for (size_t i = 0; i < count; ++i) {
        if (isnan(expected[i]) != isnan(found[i])) {
            return INFINITY;
        }
        if (!isnan(expected[i])) {
            largest = fmax(largest, fabs(expected[i]));
            away = fmax(away, fabs(expected[i] - sign * found[i]));
        }
    }
    return away == 0 ? 0.0 : away / (tolerance[1] + tolerance[0] * largest);
}

static void compare(conformance_case *one, const char *name, const double *found, size_t count) {
    const json *value = json_member(one->output, name), *limit = json_member(one->tolerance, name);
    size_t wanted = 0, two = 0;
    ++one->compared;
    if (value == NULL || limit == NULL) {
        printf("%s %s: the corpus has no output %s\n", one->stage, one->name, name);
        ++one->differences;
        return;
    }
    double *expected = json_numbers(value, &wanted), *tolerance = json_numbers(limit, &two);
    const double over =
        wanted == count ? excess(name, expected, found, count, tolerance) : INFINITY;
    if (!(over <= 1)) {
        ++one->differences;
        printf("%s %s: %s differs, %.3g times the tolerance [%g, %g]\n", one->stage, one->name,
               name, over, tolerance[0], tolerance[1]);
        for (size_t i = 0; i < wanted && i < count; ++i) {
            printf("  [%zu] expected %.17g, found %.17g\n", i, expected[i], found[i]);
        }
    }
    free(expected);
    free(tolerance);
}

/* ---- stages ---- */

static st_camera camera_of(const conformance_case *one) {
    static const char *const MODELS[] = {"plumb_bob", "rational_polynomial", "equidistant"};
    const json *camera = json_member(one->input, "camera");
    st_camera made;
    memset(&made, 0, sizeof made);
    made.width_px = (int32_t)json_member(camera, "width")->number;
    made.height_px = (int32_t)json_member(camera, "height")->number;
    made.fx_px = json_member(camera, "fx")->number;
    made.fy_px = json_member(camera, "fy")->number;
    made.cx_px = json_member(camera, "cx")->number;
    made.cy_px = json_member(camera, "cy")->number;
    size_t count = 0;
    double *terms = json_numbers(json_member(camera, "distortion"), &count);
    memcpy(made.distortion, terms, (count < 8 ? count : 8) * sizeof(double));
    free(terms);
    while (made.model < ST_LENS_MODEL_COUNT &&
           strcmp(MODELS[made.model], json_member(camera, "distortion_model")->text) != 0) {
        ++made.model;
    }
    return made;
}

static void expect_ok(conformance_case *one, const char *call, st_status status) {
    if (status != ST_OK) {
        ++one->differences;
        printf("%s %s: %s: %s\n", one->stage, one->name, call, st_status_text(status));
    }
}

#define MOST_PIXELS 64

static void camera_stage(conformance_case *one) {
    const st_camera camera = camera_of(one);
    const size_t count = input_count(one, "pixel");
    double direction[3 * MOST_PIXELS], pixel[2 * MOST_PIXELS], flow[6 * MOST_PIXELS];
    double shown[MOST_PIXELS], middle[4];
    if (count > MOST_PIXELS) {
        fprintf(stderr, "%s %s: more than %d pixels\n", one->stage, one->name, MOST_PIXELS);
        exit(2);
    }
    expect_ok(one, "st_check_camera", st_check_camera(&camera, NULL));
    const double *given = input(one, "pixel", 2 * count);
    expect_ok(one, "st_unproject", st_unproject(&camera, given, direction, count));
    expect_ok(one, "st_project", st_project(&camera, direction, pixel, count));
    expect_ok(one, "st_image_flow", st_image_flow(&camera, direction, flow, count));
    compare(one, "direction", direction, 3 * count);
    compare(one, "projected_pixel", pixel, 2 * count);
    compare(one, "flow_px_rad", flow, 6 * count);
    for (size_t i = 0; i < count; ++i) {
        shown[i] = stt_shows(&camera, given + 2 * i);
    }
    compare(one, "shown", shown, count);
    stt_middle_axes(&camera, middle);
    compare(one, "quaternion_of_middle", middle, 4);
    const double corner_rad = stt_corner_angle(&camera);
    compare(one, "corner_angle_rad", &corner_rad, 1);
}

static void rotation_stage(conformance_case *one) {
    const double *q = input(one, "quaternion", 4), *z = input(one, "axis_z", 3);
    const double *vector = input(one, "rotation_vector_rad", 3);
    double step[4], after[4], other[4], found[9], matrix[9];
    stt_quaternion_from_rotation_vector(vector, step);
    compare(one, "quaternion_of_vector", step, 4);
    stt_multiply(q, step, other);
    compare(one, "quaternion_product", other, 4);
    stt_turned(q, vector, after);
    compare(one, "quaternion_turned", after, 4);
    stt_rotation_vector_from_quaternion(step, found);
    compare(one, "vector_of_quaternion", found, 3);
    stt_attitude_error(after, q, found);
    compare(one, "attitude_error_rad", found, 3);
    stt_matrix_from_quaternion(q, matrix);
    compare(one, "matrix", matrix, 9);
    stt_sensor_direction(matrix, z, found);
    compare(one, "sensor_direction", found, 3);
    stt_turn_matrix(matrix, input(one, "rodrigues", 3), found);
    compare(one, "matrix_turned", found, 9);
    stt_matrix_from_rotation_vector(vector, found);
    compare(one, "matrix_of_vector", found, 9);
    for (int i = 0; i < 4; ++i) {
        other[i] = -q[i];
    }
    stt_sign_continuous(after, other, found);
    compare(one, "sign_continuous", found, 4);
    stt_matrix_from_quaternion(after, matrix);
    stt_quaternion_from_matrix(matrix, other);
    compare(one, "quaternion_of_matrix", other, 4);
    stt_quaternion_from_axes(z, input(one, "towards_y", 3), other);
    compare(one, "quaternion_of_axes", other, 4);
    found[0] = stt_angle_between(z, input(one, "near_z", 3));
    compare(one, "angle_rad", found, 1);
    stt_covariance_icrf(q, input(one, "covariance_sensor", 9), found);
    compare(one, "covariance_icrf", found, 9);
}

static void linear_algebra_stage(conformance_case *one) {
    const size_t size = input_count(one, "symmetric");
    const int32_t n = (int32_t)size;
    const double *symmetric = input(one, "symmetric", size * size);
    double lower[81], solution[18], found[9], gates[64], shifted[81];
    found[0] = stt_determinant(n, symmetric);
    compare(one, "determinant_3", found, 1);
    stt_inverse(n, symmetric, found);
    compare(one, "inverse_3", found, 9);
    stt_cholesky(n, symmetric, input(one, "right", 2 * size), lower, solution);
    compare(one, "cholesky", lower, size * size);
    compare(one, "solution", solution, 2 * size);
    for (size_t i = 0; i < size * size; ++i) {
        shifted[i] = symmetric[i] - (i % (size + 1) == 0 ? 2 * symmetric[0] : 0.0);
    }
    found[0] = !stt_is_positive_definite(n, symmetric);
    found[1] = !stt_is_positive_definite(n, shifted);
    compare(one, "indefinite", found, 2);
    const size_t rows = input_count(one, "probability"), columns = input_count(one, "dof");
    const double *probability = input(one, "probability", 0), *dof = input(one, "dof", 0);
    for (size_t i = 0; i < rows * columns && i < 64; ++i) {
        gates[i] = stt_gate(probability[i / columns], dof[i % columns]);
    }
    compare(one, "gate", gates, rows * columns);
}

/* Whether a file is accepted with a byte changed, its end cut off, and the checksum corrected. */
static double accepts(const uint8_t *file, uint64_t bytes, const double damage[4]) {
    const uint64_t left = bytes - (uint64_t)damage[2];
    uint8_t *copy = sky_copy(file, left);
    copy[(uint64_t)damage[0]] ^= (uint8_t)damage[1];
    if (damage[3] != 0) {
        sky_seal(copy, left);
    }
    const st_sky sky = {copy, left};
    const st_status status = st_check_sky(&sky, NULL);
    free(copy);
    return status == ST_OK;
}

static void sky_stage(conformance_case *one) {
    uint64_t bytes = 0;
    uint8_t *made = sky_file(json_member(one->input, "sections"), &bytes);
    uint8_t *file = sky_copy(made, bytes);
    const st_sky sky = {file, bytes};
    expect_ok(one, "st_check_sky", st_check_sky(&sky, NULL));
    double found[16] = {(double)bytes, 0};
    compare(one, "bytes", found, 1);
    found[0] = crc32(file + SKY_CHECKED_FROM, bytes - SKY_CHECKED_FROM);
    compare(one, "checksum", found, 1);

    int32_t index[MOST_PIXELS], range[2];
    double brightest[MOST_PIXELS], direction[3];
    const double *axis = input(one, "axis", 3);
    const int32_t count =
        stt_stars_in_cone(&sky, axis, *input(one, "radius_rad", 1), index, MOST_PIXELS);
    for (int32_t i = 0; i < count && i < MOST_PIXELS; ++i) {
        brightest[i] = index[i];
    }
    compare(one, "stars_in_cone", brightest, (size_t)count);
    found[0] = stt_nearest_star(&sky, axis, 2.0, &found[1]);
    compare(one, "nearest_pattern_star", found, 1);
    const double *interval = input(one, "separation_rad", 2);
    for (int32_t bright = 0; bright < 2; ++bright) {
        stt_pairs_between(&sky, bright, interval[0], interval[1], range);
        found[2 * bright] = range[0];
        found[2 * bright + 1] = range[1];
    }
    compare(one, "pairs_between", found, 4);
    stt_direction_at(&sky, (int32_t)*input(one, "star", 1), *input(one, "years", 1),
                     input(one, "moved_au", 3), direction);
    compare(one, "direction", direction, 3);
    const size_t rows = input_count(one, "damage");
    const double *damage = input(one, "damage", 4 * rows);
    for (size_t i = 0; i < rows && i < 16; ++i) {
        found[i] = accepts(made, bytes, damage + 4 * i);
    }
    compare(one, "accepted", found, rows);
    free(file);
    free(made);
}

/* Frames of centroids, identified until they are tracked, and the attitude that is trusted. */
static void tracking_stage(conformance_case *one) {
    static const st_abi ABI = ST_ABI;
    enum { MOST_FRAMES = 16 };
    uint64_t file_bytes = 0;
    uint8_t *made = sky_file(json_member(one->input, "sections"), &file_bytes);
    uint8_t *file = sky_copy(made, file_bytes);
    const st_sky sky = {file, file_bytes};
    const st_camera camera = camera_of(one);
    const size_t frames = input_count(one, "stamp_ns"), stars = input_count(one, "hip");
    const double *stamp_ns = input(one, "stamp_ns", frames), *count = input(one, "count", frames);
    const double *numbers = input(one, "centroid", 12 * stars), *hip = input(one, "hip", stars);
    double state[MOST_FRAMES], reason[MOST_FRAMES], matched[MOST_FRAMES];
    size_t bytes = 0, tracks = 0, first = 0;
    st_tracker *tracker = NULL;
    st_tracking tracking;
    st_trusted trusted;
    st_attitude later;
    st_config config;
    st_defaults(&config, &ABI);
    config.stages = ST_TRACKS | ST_TRUSTS;
    config.tracking.model = (int32_t)*input(one, "model", 1);
    expect_ok(one, "st_check_sky", st_check_sky(&sky, NULL));
    expect_ok(one, "st_size", st_size(&config, &camera, &sky, &bytes));
    void *memory = aligned_alloc(64, bytes);
    expect_ok(one, "st_create", st_create(memory, bytes, &config, &camera, &sky, &tracker, NULL));
    memset(&trusted, 0, sizeof trusted);
    for (size_t frame = 0; frame < frames && frame < MOST_FRAMES; ++frame) {
        const size_t of_frame = (size_t)count[frame];
        const int64_t stamp = (int64_t)stamp_ns[frame];
        st_centroid *centroids = calloc(of_frame, sizeof *centroids);
        st_identified *identified = calloc(of_frame, sizeof *identified);
        memcpy(centroids, numbers + 12 * first, of_frame * sizeof *centroids);
        for (size_t i = 0; i < of_frame; ++i) {
            identified[i].hip = (int32_t)hip[first + i];
        }
        expect_ok(one, "st_track", st_track(tracker, stamp, centroids, of_frame, NULL, &tracking));
        const st_star_track *list = st_tracks(tracker, &tracks);
        expect_ok(one, "st_trust",
                  st_trust(tracker, stamp, list, tracks, &tracking.attitude, &trusted));
        if (tracking.state != ST_TRACKING) {
            expect_ok(
                one, "st_add_identification",
                st_add_identification(tracker, stamp, centroids, identified, of_frame, &tracking));
        }
        state[frame] = tracking.state;
        reason[frame] = tracking.reason.code;
        matched[frame] = tracking.stars_matched;
        first += of_frame;
        free(centroids);
        free(identified);
    }
    expect_ok(one, "st_attitude_at",
              st_attitude_at(&trusted.attitude, trusted.attitude.stamp_ns + 50000000, &later));
    compare(one, "state", state, frames);
    compare(one, "reason", reason, frames);
    compare(one, "stars_matched", matched, frames);
    compare(one, "quaternion", trusted.attitude.quaternion, 4);
    compare(one, "covariance", &trusted.attitude.covariance_rad2[0][0], 9);
    compare(one, "rate", trusted.attitude.rate_rad_s, 3);
    compare(one, "rate_covariance", &trusted.attitude.rate_covariance[0][0], 9);
    compare(one, "protection", trusted.attitude.protection_rad, 3);
    compare(one, "quaternion_later", later.quaternion, 4);
    compare(one, "covariance_later", &later.covariance_rad2[0][0], 9);
    free(memory);
    free(file);
    free(made);
}

/* ---- the corpus ---- */

typedef struct {
    const char *name;
    void (*run)(conformance_case *);
} conformance_stage;

/* A stage joins with the commit that implements it. */
static const conformance_stage STAGES[] = {
    {"camera", camera_stage},
    {"rotation", rotation_stage},
    {"linear_algebra", linear_algebra_stage},
    {"sky", sky_stage},
    {"tracking", tracking_stage},
};

static int run_stage(const char *folder, const conformance_stage *stage) {
    char path[4096];
    snprintf(path, sizeof path, "%s/%s.json", folder, stage->name);
    json *document = json_read(path);
    int cases = 0, outputs = 0, differences = 0;
    const json *all = json_member(document, "cases");
    for (const json *item = all == NULL ? NULL : all->first; item != NULL; item = item->next) {
        conformance_case one = {.stage = stage->name,
                                .name = json_member(item, "name")->text,
                                .input = json_member(item, "input"),
                                .output = json_member(item, "output"),
                                .tolerance = json_member(document, "tolerance")};
        stage->run(&one);
        if ((size_t)one.compared != one.output->count) {
            printf("%s %s: %d of %zu outputs are compared\n", one.stage, one.name, one.compared,
                   one.output->count);
            ++differences;
        }
        ++cases;
        outputs += one.compared;
        differences += one.differences;
        while (one.read > 0) {
            free(one.numbers[--one.read]);
        }
    }
    printf("%s: %d cases, %d outputs, %d differences\n", stage->name, cases, outputs, differences);
    json_free(document);
    return cases == 0 ? 1 : differences;
}

int main(int count, char **arguments) {
    if (count != 2) {
        fprintf(stderr, "usage: conformance FOLDER\n");
        return 2;
    }
    int differences = 0;
    printf("%s\n", st_build_text());
    for (size_t i = 0; i < sizeof STAGES / sizeof STAGES[0]; ++i) {
        differences += run_stage(arguments[1], &STAGES[i]);
    }
    return differences != 0;
}

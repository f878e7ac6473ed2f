// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * fuzz ROUNDS SEED: impossible, huge and undefined input to every function, in memory without a
 * byte to spare. Meant for a build with sanitizers, which end the program; exit status 1 where an
 * answer is wrong. A round that fails is repeated by its number as SEED with one round.
 */

#include <float.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "random.h"
#include "startracker.h"

/* ---- random input ---- */

static uint64_t one_of(uint64_t count) {
    return random_bits() % count;
}

/* Mostly a number of the range; else a special one, or any bits. */
static double number(double least, double most) {
    static const double SPECIAL[] = {0.0,          -0.0,      1.0,     -1.0,     NAN,
                                     INFINITY,     -INFINITY, DBL_MAX, -DBL_MAX, DBL_MIN,
                                     DBL_TRUE_MIN, 1e-300,    1e300,   65536.5};
    const uint64_t kind = one_of(16);
    if (kind == 0) {
        return SPECIAL[one_of(sizeof SPECIAL / sizeof SPECIAL[0])];
    }
    if (kind == 1) {
        const uint64_t bits = random_bits();
        double any;
        memcpy(&any, &bits, sizeof any);
        return any;
    }
    return within(least, most);
}

static int32_t whole(int32_t least, int32_t most) {
    return one_of(16) == 0 ? (int32_t)(uint32_t)random_bits()
                           : least + (int32_t)one_of((uint64_t)(most - least + 1));
}

/* An array without a byte to spare. */
static double *numbers(size_t count, double least, double most) {
    double *array = malloc(count * sizeof(double) + (count == 0));
    for (size_t i = 0; i < count; ++i) {
        array[i] = number(least, most);
    }
    return array;
}

/* ---- what is fuzzed ---- */

static st_camera any_camera(void) {
    st_camera camera;
    memset(&camera, 0, sizeof camera);
    camera.width_px = whole(1, 4096);
    camera.height_px = whole(1, 4096);
    camera.fx_px = number(50, 8000);
    camera.fy_px = one_of(2) ? camera.fx_px : number(50, 8000);
    camera.cx_px = number(-100, 4200);
    camera.cy_px = number(-100, 4200);
    camera.model = whole(0, ST_LENS_MODEL_COUNT - 1);
    const uint64_t terms = one_of(9);
    for (uint64_t i = 0; i < terms; ++i) {
        camera.distortion[i] = number(-0.2, 0.2);
    }
    return camera;
}

/* A pixel of a possible camera comes back, or has no direction. */
static int camera_round(void) {
    const st_camera camera = any_camera();
    const size_t count = (size_t)one_of(20);
    st_fault fault;
    const int possible = st_check_camera(&camera, one_of(2) ? &fault : NULL) == ST_OK;
    double *pixel = numbers(2 * count, -0.5, 4095.5), *direction = numbers(3 * count, -1, 1);
    double *flow = numbers(6 * count, 0, 1), *again = numbers(2 * count, 0, 1);
    st_project(&camera, direction, again, count);
    st_image_flow(&camera, direction, flow, count);
    st_unproject(&camera, pixel, direction, count);
    st_project(&camera, direction, again, count);
    int wrong = 0;
    for (size_t i = 0; possible && i < count; ++i) {
        const double u = pixel[2 * i], v = pixel[2 * i + 1];
        const int inside =
            u >= 0 && u <= camera.width_px - 1 && v >= 0 && v <= camera.height_px - 1;
        const double away = fmax(fabs(again[2 * i] - u), fabs(again[2 * i + 1] - v));
        wrong |= inside && away > 1e-6 * fmax(camera.fx_px, camera.fy_px);
    }
    if (wrong) {
        printf("a pixel of a possible camera does not come back\n");
    }
    free(pixel);
    free(direction);
    free(flow);
    free(again);
    return wrong;
}

/* Options of any bits are refused by name or possible; all that are not finite are refused. */
static int config_round(void) {
    static const st_abi ABI = ST_ABI;
    st_abi other = ABI;
    st_config config;
    st_fault fault;
    memset(&fault, 0, sizeof fault);
    if (st_defaults(&config, &ABI) != ST_OK) {
        printf("no defaults\n");
        return 1;
    }
    unsigned char *bytes = (unsigned char *)&config;
    const uint64_t changes = one_of(4);
    for (uint64_t i = 0; i < changes; ++i) {
        const double any = number(-10, 10);
        const size_t first = offsetof(st_config, epoch_year) / sizeof any;
        const size_t place = (first + one_of(sizeof config / sizeof any - first)) * sizeof any;
        memcpy(bytes + place, &any, sizeof any);
    }
    const st_status status = st_check_config(&config, &fault);
    ((uint32_t *)&other)[one_of(sizeof other / sizeof(uint32_t))] ^= (uint32_t)1 << one_of(32);
    const int wrong = (status != ST_OK && (fault.name == NULL || status != ST_OUT_OF_RANGE)) ||
                      (changes == 0 && status != ST_OK) || st_check_abi(&other) == ST_OK;
    if (wrong) {
        printf("options: status %d, %s\n", (int)status, fault.name == NULL ? "-" : fault.name);
    }
    return wrong;
}

static int (*const ROUNDS[])(void) = {camera_round, config_round};

int main(int count, char **arguments) {
    if (count != 3) {
        fprintf(stderr, "usage: fuzz ROUNDS SEED\n");
        return 2;
    }
    const uint64_t rounds = strtoull(arguments[1], NULL, 10),
                   seed = strtoull(arguments[2], NULL, 10);
    for (uint64_t round = seed; round < seed + rounds; ++round) {
        for (size_t i = 0; i < sizeof ROUNDS / sizeof ROUNDS[0]; ++i) {
            state = round * 0x2545f4914f6cdd1du + i;
            if (ROUNDS[i]() != 0) {
                printf("fuzz: 1 %" PRIu64 " repeats it\n", round);
                return 1;
            }
        }
    }
    printf("fuzz: %" PRIu64 " rounds, 0 failures\n", rounds);
    return 0;
}

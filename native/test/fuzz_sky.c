// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * fuzz_sky CORPUS ROUNDS SEED: damages the first sky file of the corpus again and again, bits of
 * header, table and sections, and cuts it off, with the checksum corrected and not. It is refused
 * by name, or what is asked of it reads nothing outside it, as sanitizers see. Exit status 1 where
 * the file itself is refused. A round that fails is repeated by its number as SEED with one round.
 */

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "kernels.h"
#include "random.h"
#include "sky_file.h"

#define MOST_STARS 64

/* Return how many answers are impossible. */
static int ask(const st_sky *sky) {
    int32_t index[MOST_STARS], range[2];
    double square, direction[3], axis[3], moved_au[3];
    int impossible = 0;
    for (int i = 0; i < 3; ++i) {
        axis[i] = within(-1, 1);
        moved_au[i] = within(-2, 2);
    }
    const int32_t found = stt_stars_in_cone(sky, axis, within(0, 4), index, MOST_STARS);
    for (int32_t i = 0; i < found && i < MOST_STARS; ++i) {
        stt_direction_at(sky, index[i], within(-40, 40), moved_au, direction);
    }
    stt_nearest_star(sky, axis, within(0, 2), &square);
    for (int32_t bright = 0; bright < 2; ++bright) {
        const double low = within(-1, 4);
        stt_pairs_between(sky, bright, low, low + within(-1, 4), range);
        impossible += range[0] > range[1] || range[0] < 0;
    }
    return impossible;
}

/* Return 1 where something is wrong. */
static int try_file(const uint8_t *file, uint64_t bytes, uint64_t round) {
    state = round;
    const uint64_t left = random_bits() % 5 == 0 ? random_bits() % bytes : bytes;
    uint8_t *copy = sky_copy(file, left);
    for (uint64_t n = 1 + random_bits() % 3; n > 0 && left > 0; --n) {
        /* Half of them in header and table. */
        const uint64_t part = random_bits() % 2 == 0 && left > 3072 ? 3072 : left;
        copy[random_bits() % part] ^= (uint8_t)(1U << random_bits() % 8);
    }
    if (random_bits() % 4 != 0 && left >= 64) {
        sky_seal(copy, left);
    }
    const st_sky sky = {copy, left};
    st_fault fault = {NULL, 0, 0, 0};
    const st_status status = st_check_sky(&sky, &fault);
    const int wrong =
        status == ST_OK ? ask(&sky) != 0 : status != ST_BAD_SKY || fault.name == NULL;
    if (wrong) {
        printf("round %" PRIu64 ": %s, %s\n", round, st_status_text(status),
               fault.name == NULL ? "no fault" : fault.name);
    }
    free(copy);
    return wrong;
}

int main(int count, char **arguments) {
    if (count != 4) {
        fprintf(stderr, "usage: fuzz_sky CORPUS ROUNDS SEED\n");
        return 2;
    }
    uint64_t bytes = 0;
    uint8_t *file = first_sky(arguments[1], &bytes);
    const uint64_t rounds = strtoull(arguments[2], NULL, 10),
                   seed = strtoull(arguments[3], NULL, 10);
    int failures = 0;
    for (uint64_t round = seed; round < seed + rounds; ++round) {
        failures += try_file(file, bytes, round);
    }
    printf("%" PRIu64 " rounds, %d failures\n", rounds, failures);
    free(file);
    return failures != 0;
}

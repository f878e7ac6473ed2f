// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * sky FILE ROUNDS: damages a sky file again and again, bytes of the header and of all parts, cut
 * off, with the checksum corrected and not. st_check_sky refuses it, or what is asked of it reads
 * nothing outside it, as sanitizers see. Exit status 1 where the file itself is refused.
 */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "kernels.h"

#define LIST 64

static uint64_t state = 1;

static uint64_t drawn(uint64_t below) {
    state = state * 6364136223846793005U + 1442695040888963407U;
    return below == 0 ? 0 : (state >> 20) % below;
}

static uint32_t crc32(const uint8_t *bytes, uint64_t count) {
    uint32_t crc = 0xFFFFFFFFU;
    for (uint64_t i = 0; i < count; ++i) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; ++bit) {
            crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0xEDB88320U : 0U);
        }
    }
    return ~crc;
}

static void ask(const st_sky *sky) {
    const double axis[3] = {0.6, 0.0, 0.8}, at_rest[3] = {0, 0, 0};
    double square, direction[3];
    int32_t index[LIST], range[2];
    stt_stars_in_cone(sky, axis, 0.5, index, LIST);
    stt_nearest_star(sky, axis, 0.1, &square);
    stt_direction_at(sky, 0, 0.5, at_rest, direction);
    for (int32_t bright = 0; bright < 2; ++bright) {
        stt_pairs_between(sky, bright, 0.01, 0.1, range);
    }
}

int main(int count, char **arguments) {
    FILE *file = count == 3 ? fopen(arguments[1], "rb") : NULL;
    if (file == NULL || fseek(file, 0, SEEK_END) != 0) {
        fprintf(stderr, "usage: sky FILE ROUNDS\n");
        return 2;
    }
    const uint64_t bytes = (uint64_t)ftell(file);
    uint8_t *whole = malloc(bytes);
    rewind(file);
    if (whole == NULL || fread(whole, 1, bytes, file) != bytes) {
        return 2;
    }
    fclose(file);
    int accepted = 0, rounds = atoi(arguments[2]);
    for (int round = 0; round <= rounds; ++round) {
        /* Of the size of what is left, so that a sanitizer sees what is read beyond. */
        const uint64_t left = round % 5 == 4 ? drawn(bytes) : bytes;
        uint8_t *copy = aligned_alloc(64, (left + 63) / 64 * 64 + 64);
        if (copy == NULL) {
            return 2;
        }
        memcpy(copy, whole, left);
        for (uint64_t n = round == 0 ? 0 : 1 + drawn(3); n > 0 && left > 0; --n) {
            const uint64_t table = left < 4096 ? left : 4096;
            copy[drawn(2) != 0 ? drawn(table) : drawn(left)] ^= (uint8_t)(1U << drawn(8));
        }
        if (round % 4 != 3 && round > 0 && left > 64) {
            memcpy(copy + 16, &left, sizeof left);
            const uint32_t checksum = crc32(copy + 16, left - 16);
            memcpy(copy + 12, &checksum, sizeof checksum);
        }
        const st_sky sky = {copy, left};
        st_fault fault = {NULL, 0, 0, 0};
        const st_status status = st_check_sky(&sky, &fault);
        if (status == ST_OK) {
            ++accepted;
            ask(&sky);
        } else if (status != ST_BAD_SKY || fault.name == NULL || round == 0) {
            printf("round %d: %s, %s\n", round, st_status_text(status),
                   fault.name == NULL ? "no fault" : fault.name);
            return 1;
        }
        free(copy);
    }
    printf("%d of %d files accepted\n", accepted, rounds + 1);
    free(whole);
    return 0;
}

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/* Random numbers of the fuzzers, the same on every machine: set state to a seed. */

#ifndef RANDOM_H
#define RANDOM_H

#include <stdint.h>

/* SplitMix64 (Steele, Lea and Flood, OOPSLA 2014). */
static uint64_t state;

static uint64_t random_bits(void) {
    uint64_t z = (state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

static double within(double least, double most) {
    return least + (most - least) * ((double)(random_bits() >> 11) / 9007199254740992.0);
}

#endif

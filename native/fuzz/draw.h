/* What the fuzz driver draws from: one stream of numbers for each case, made of the case's seed; and arrays with
 * guard words on both sides, so that a write outside of them is seen with and without a sanitizer. */
#ifndef ZOO_FUZZ_DRAW_H
#define ZOO_FUZZ_DRAW_H

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(__SANITIZE_ADDRESS__)
#define FUZZ_ASAN 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define FUZZ_ASAN 1
#endif
#endif
#ifdef FUZZ_ASAN
#include <sanitizer/asan_interface.h>
#else
#define ASAN_POISON_MEMORY_REGION(at, size) ((void)(at), (void)(size))
#define ASAN_UNPOISON_MEMORY_REGION(at, size) ((void)(at), (void)(size))
#endif

static uint64_t stream;

/* splitmix64 (Steele, Lea & Flood 2014, doi 10.1145/2660193.2660195) */
static inline uint64_t draw(void)
{
    uint64_t z = stream += 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

static inline int below(int n)
{
    return (int)(draw() % (uint64_t)n);
}

static inline int one_in(int n)
{
    return below(n) == 0;
}

static inline double between(double low, double high)
{
    return low + (high - low) * ((double)(draw() >> 11) / 9007199254740992.0);
}

static inline double log_between(double low, double high)
{
    return exp(between(log(low), log(high)));
}

/* A number that nobody means. */
static inline double hostile_real(double ordinary)
{
    static const double odd[] = {NAN,    INFINITY, -INFINITY, 0.0,     -0.0,    5e-324,  -5e-324, DBL_MIN,
                                 DBL_MAX, -DBL_MAX, 1e-310,    1e-300,  1e300,   1e-40,   1e-160,  1e38,
                                 3.5e38,  1e19,     9.3e18,    2.2e9,   -2.2e9,  1.0,     -1.0,    0.5};
    const int kind = below(4);
    if (kind < 2)
        return odd[below(sizeof odd / sizeof *odd)];
    if (kind == 2)
        return -ordinary;
    return ordinary * log_between(1e-12, 1e12);
}

static inline int32_t hostile_count(void)
{
    static const int32_t odd[] = {0, -1, INT_MIN, INT_MAX, INT_MAX - 1, 1 << 30, 1 << 29, (1 << 28) + 1, -(1 << 28)};
    return odd[below(sizeof odd / sizeof *odd)];
}

/* An array of the caller's, between guards. */
enum { GUARD = 64, MOST_ARRAYS = 64 };
static struct {
    char *memory;
    size_t size;
} array[MOST_ARRAYS];
static int n_arrays;

/* `off` bytes past an address that malloc gave; every byte of it is `fill`. */
static inline void *array_new(size_t size, int off, int fill)
{
    if (n_arrays == MOST_ARRAYS)
        abort();
    char *memory = malloc(size + 2 * GUARD + (size_t)off);
    if (!memory)
        abort();
    memset(memory, 0xa5, size + 2 * GUARD + (size_t)off);
    char *at = memory + GUARD + off;
    memset(at, fill, size);
    ASAN_POISON_MEMORY_REGION(memory, (size_t)(at - memory));
    ASAN_POISON_MEMORY_REGION(at + size, GUARD);
    array[n_arrays].memory = memory;
    array[n_arrays++].size = size + 2 * GUARD + (size_t)off;
    return at;
}

/* 1 if a guard of `at`, an array of `size` bytes, has been written to. */
static inline int guard_broken(const void *data, size_t size)
{
    const unsigned char *at = data;
    int broken = 0;
    ASAN_UNPOISON_MEMORY_REGION(at - GUARD, GUARD);
    ASAN_UNPOISON_MEMORY_REGION(at + size, GUARD);
    for (int i = 0; i < GUARD; i++)
        broken |= at[-1 - i] != 0xa5 || at[size + (size_t)i] != 0xa5;
    return broken;
}

static inline void arrays_free(void)
{
    while (n_arrays > 0) {
        n_arrays--;
        ASAN_UNPOISON_MEMORY_REGION(array[n_arrays].memory, array[n_arrays].size);
        free(array[n_arrays].memory);
    }
}

static inline uint64_t digest(uint64_t sum, const void *data, size_t size)
{
    const unsigned char *at = data;
    for (size_t i = 0; i < size; i++)
        sum = (sum ^ at[i]) * 0x100000001b3u;
    return sum;
}

#endif

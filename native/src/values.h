/* Ranges of numbers and arrays, for the checks of arguments; an array that is NULL is not there. */
#ifndef ZOO_VALUES_H
#define ZOO_VALUES_H

#include <math.h>
#include <stdint.h>

/* 1 unless x is positive and finite. */
static inline int value_bad(double x)
{
    return !(x > 0.0) || isinf(x);
}

/* 1 unless x is positive and far from the ends of single precision, in which arithmetic.h starts. */
static inline int value_extreme(double x)
{
    return !(x > 1e-30 && x < 1e30);
}

/* 1 when the array is there and a value lies outside [low, high] or is not finite. */
static inline int values_outside(const double *values, int64_t n, double low, double high)
{
    for (int64_t i = 0; values && i < n; i++)
        if (!(values[i] >= low && values[i] <= high) || isinf(values[i]))
            return 1;
    return 0;
}

/* 1 when the array is there and a value is another one. */
static inline int values_differ(const double *values, int64_t n, double from)
{
    for (int64_t i = 0; values && i < n; i++)
        if (values[i] != from)
            return 1;
    return 0;
}

/* The whole number below x, cut to 0 .. most; 0 for NaN.  A conversion out of the range of int is undefined. */
static inline int whole(double x, int most)
{
    return x >= most ? most : x > 0.0 ? (int)x : 0;
}

static inline double value_or_zero(const double *values, int k)
{
    return values ? values[k] : 0.0;
}

#endif

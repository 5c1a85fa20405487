/* Arithmetic as the kernels have it. Of the maths library: square root, floor, ceil, fmod and absolute value, all exact. */
#ifndef BELTARM_ARITHMETIC_H
#define BELTARM_ARITHMETIC_H

#include "real.h"

#if defined(_MSC_VER) /* sums of products are rounded as they are in the kernels */
#pragma fp_contract(off)
#elif defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__) && !defined(__STRICT_ANSI__)
#pragma GCC optimize("fp-contract=off")
#endif

#ifdef BELTARM_SINGLE
#define real_sqrt sqrtf
#define real_floor floorf
#define real_ceil ceilf
#define real_fmod fmodf
#define real_abs fabsf
#define ROUNDER 12582912.0f
#define PRECISE(in_double, in_single) ((real)(in_single))
#else
#define real_sqrt sqrt
#define real_floor floor
#define real_ceil ceil
#define real_fmod fmod
#define real_abs fabs
#define ROUNDER 6755399441055744.0
#define PRECISE(in_double, in_single) (in_double)
#endif
#define R(x) ((real)(x))

/* First half of rounding, (x + ROUNDER) - ROUNDER: the sum goes through memory, so that no compiler takes it away. */
static inline real plus_rounder(real x)
{
#ifdef BELTARM_ROUNDS_HERE
    return x + ROUNDER;
#else
    volatile real sum = x + ROUNDER;
    return sum;
#endif
}
static inline real real_max(real a, real b) { return b > a ? b : a; }
static inline real real_min(real a, real b) { return b < a ? b : a; }

static inline float float_max(float a, float b) { return b > a ? b : a; }
static inline float float_min(float a, float b) { return b < a ? b : a; }

static inline int64_t int_max(int64_t a, int64_t b) { return b > a ? b : a; }
static inline int64_t int_min(int64_t a, int64_t b) { return b < a ? b : a; }
static inline real real_sign(real a) { return a > 0 ? R(1) : (a < 0 ? R(-1) : a); }
static inline real square(real a) { return a * a; }
static inline real cube(real a) { return a * (a * a); }
static inline real fourth_power(real a) { return (a * a) * (a * a); }

/* Whole numbers wrap at 64 bits, as the kernels' do: signed overflow is undefined in C, so these are unsigned. */
static inline int64_t int_add(int64_t a, int64_t b) { return (int64_t)((uint64_t)a + (uint64_t)b); }
static inline int64_t int_sub(int64_t a, int64_t b) { return (int64_t)((uint64_t)a - (uint64_t)b); }
static inline int64_t int_mul(int64_t a, int64_t b) { return (int64_t)((uint64_t)a * (uint64_t)b); }
static inline int64_t int_abs(int64_t a) { return a < 0 ? int_sub(0, a) : a; }

/* By 64 places and more nothing is left; C leaves open what a shift by so many gives. */
static inline uint64_t shift_left(uint64_t a, uint64_t b) { return b < 64 ? a << b : 0; }
static inline uint64_t shift_right(uint64_t a, uint64_t b) { return b < 64 ? a >> b : 0; }

static inline int64_t floor_div(int64_t a, int64_t b)
{
    if (b == 0 || b == -1) {
        return int_mul(a, b);
    }
    int64_t whole = a / b;
    return (a % b != 0 && (a < 0) != (b < 0)) ? whole - 1 : whole;
}

static inline int64_t floor_mod(int64_t a, int64_t b)
{
    if (b == 0 || b == -1) {
        return 0;
    }
    int64_t rest = a % b;
    return (rest != 0 && (rest < 0) != (b < 0)) ? rest + b : rest;
}

/* Whole part; of what 64 bits do not hold, the least number. */
static inline int64_t int_of(real a)
{
    return a >= R(-9223372036854775808.0) && a < R(9223372036854775808.0) ? (int64_t)a : INT64_MIN;
}

/* Index from an index of Python, which may count from the end; and one of a slice, which is cut. */
static inline int64_t int_at(int64_t a, int64_t size) { return a < 0 ? a + size : a; }
static inline int64_t int_cut(int64_t a, int64_t size) { return int_min(int_max(int_at(a, size), 0), size); }

static inline real real_mod(real a, real b)
{
    real rest = real_fmod(a, b);
    if (rest == 0) {
        return b < 0 ? -R(0) : R(0);
    }
    return (rest < 0) != (b < 0) ? rest + b : rest;
}

static inline real real_floor_div(real a, real b)
{
    if (b == 0) {
        return a / b;
    }
    real rest = real_fmod(a, b);
    real whole = (a - rest) / b;
    if (rest != 0 && (rest < 0) != (b < 0)) {
        whole -= R(1);
    }
    if (whole == 0) {
        return R(0) * (a / b);
    }
    real below = real_floor(whole);
    return whole - below > R(0.5) ? below + R(1) : below;
}

#endif

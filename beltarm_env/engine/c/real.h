/* Numbers: double precision, or single precision with -DBELTARM_SINGLE. Refuses compilers that round differently. */
#ifndef BELTARM_REAL_H
#define BELTARM_REAL_H

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef BELTARM_SINGLE
typedef float real;
#define REAL_EPSILON FLT_EPSILON
#define REAL_MIN FLT_MIN
#else
typedef double real;
#define REAL_EPSILON DBL_EPSILON
#define REAL_MIN DBL_MIN
#endif

#if defined(__FAST_MATH__) || defined(_M_FP_FAST)
#error "build without -ffast-math, -Ofast or /fp:fast: results have to be those that were compared"
#endif
#ifdef __ASSOCIATIVE_MATH__
#error "build without -fassociative-math and -funsafe-math-optimizations: results have to be those that were compared"
#endif
#ifdef __RECIPROCAL_MATH__
#error "build without -freciprocal-math and -funsafe-math-optimizations: results have to be those that were compared"
#endif
#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0
#error "build without -ffinite-math-only: what is no number has to be seen"
#endif
#ifdef __NO_SIGNED_ZEROS__
#error "build without -fno-signed-zeros: results have to be those that were compared"
#endif
#if FLT_EVAL_METHOD != 0 && FLT_EVAL_METHOD != 16 /* 16: as 0, with numbers of half precision beside it */
#error "build so that FLT_EVAL_METHOD is 0: numbers must not be kept with more digits (on x86: -msse2 -mfpmath=sse)"
#endif
#if FLT_RADIX != 2 || FLT_MANT_DIG != 24 || (!defined(BELTARM_SINGLE) && DBL_MANT_DIG != 53)
#error "float must have 24 binary digits, and double 53: this compiler's have others"
#endif
typedef char build_without_single_precision_constants[sizeof(1.0) >= sizeof(real) ? 1 : -1];

#endif

/* Level of the instructions that this processor has. */
#ifndef BELTARM_LEVEL_H
#define BELTARM_LEVEL_H

#if defined(__x86_64__)
#include <cpuid.h>
#endif

/* Return the level of this processor, 1 to 4 for x86-64, x86-64-v2, -v3 and -v4; 0 for other kinds of processors. */
static int level(void)
{
#if defined(__x86_64__)
    enum { BASE_2 = 1 << 0 | 1 << 9 | 1 << 13 | 1 << 19 | 1 << 20 | 1 << 23 /* SSE3 to SSE4.2, CX16, POPCNT */ };
    enum { BASE_3 = 1 << 12 | 1 << 22 | 1 << 28 | 1 << 29 /* FMA, MOVBE, AVX, F16C */, LAHF = 1 << 0, LZCNT = 1 << 5 };
    enum { MORE_3 = 1 << 3 | 1 << 5 | 1 << 8 /* BMI1, AVX2, BMI2 */, MORE_4 = 1 << 16 | 1 << 17 | 1 << 28 | 1 << 30 };
    const unsigned avx512vl = 1u << 31, has_xgetbv = 1u << 27;
    unsigned a, b, base, d, more = 0, extended = 0, kept = 0;
    if (!__get_cpuid(1, &a, &b, &base, &d)) return 1;
    if (!__get_cpuid_count(7, 0, &a, &more, &b, &d)) more = 0;
    if (!__get_cpuid(0x80000001, &a, &b, &extended, &d)) extended = 0;
    /* Which registers the operating system saves */
    if (base & has_xgetbv) __asm__ volatile("xgetbv" : "=a"(kept), "=d"(d) : "c"(0));
    if ((base & BASE_2) != BASE_2 || !(extended & LAHF)) return 1;
    if ((base & BASE_3) != BASE_3 || (more & MORE_3) != MORE_3 || !(extended & LZCNT) || (kept & 0x6) != 0x6) return 2;
    return (more & MORE_4) == MORE_4 && (more & avx512vl) && (kept & 0xe6) == 0xe6 ? 4 : 3;
#else
    return 0;
#endif
}

#endif

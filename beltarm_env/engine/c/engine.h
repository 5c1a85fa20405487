/* What the C of a kernel needs that Python calls: memory, checks, and what it gives back. */
#ifndef BELTARM_ENGINE_H
#define BELTARM_ENGINE_H

#define BELTARM_ROUNDS_HERE /* flags of this build keep every rounding */
#include "arithmetic.h"

#include <setjmp.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#define INLINED static inline __attribute__((always_inline))

typedef union {
    double d;
    int64_t n;
    void *p;
} Slot;

/* A failure ends the kernel: `fail` goes back to its entry, which gives the text to Python. */
static _Thread_local jmp_buf beltarm_entry;
static _Thread_local const char *beltarm_failure;

static __attribute__((noinline, noreturn, unused)) void fail(const char *text)
{
    beltarm_failure = text;
    longjmp(beltarm_entry, 1);
}

/* Arrays on the heap, the newest first; each thread has its own. */
typedef union HeapArray {
    union HeapArray *before;
    max_align_t aligned;
} HeapArray;
static _Thread_local HeapArray *beltarm_heap;

static inline void *heap_mark(void) { return beltarm_heap; }

static __attribute__((unused)) void heap_release(void *mark)
{
    while (beltarm_heap != mark) {
        HeapArray *newest = beltarm_heap;
        beltarm_heap = newest->before;
        free(newest);
    }
}

static __attribute__((noinline, unused, malloc)) void *heap_array(size_t size, int64_t count)
{
    HeapArray *made = count < 0 ? NULL : malloc(sizeof(HeapArray) + size * (size_t)count);
    if (made == NULL) {
        fail(count < 0 ? "an array has a negative length" : "there is not enough memory for an array");
    }
    made->before = beltarm_heap;
    beltarm_heap = made;
    return made + 1;
}

/* Copy of an array for Python, which frees it. */
static __attribute__((unused)) void *given_array(const void *array, size_t size, int64_t count)
{
    void *copy = malloc(count > 0 ? size * (size_t)count : 1);
    if (copy == NULL) {
        fail("there is not enough memory for a result");
    }
    return memcpy(copy, array, count > 0 ? size * (size_t)count : 0);
}

#define TAKE_FAILURES                                                                                                  \
    if (setjmp(beltarm_entry) != 0) {                                                                                  \
        heap_release(NULL);                                                                                            \
        return beltarm_failure;                                                                                        \
    }
#define CHECK_EQUAL(a, b, where)                                                                                       \
    if ((a) != (b)) {                                                                                                  \
        fail("arrays of one length are expected in " where);                                                           \
    }

static inline __attribute__((unused)) int64_t checked_at(const char *text, int64_t at, int64_t size)
{
    if (at < 0 || at >= size) {
        fail(text);
    }
    return at;
}
#define CHECKED_AT(where, at, size) checked_at("an index is outside its axis in " where, at, size)

#ifdef BELTARM_CHECKED
#define BEYOND "a whole number is beyond 64 bits in a kernel"
#define CHECKED_WHOLE(name, operation)                                                                                 \
    static inline __attribute__((unused)) int64_t checked_##name(int64_t a, int64_t b)                                 \
    {                                                                                                                  \
        int64_t result;                                                                                                \
        if (operation(a, b, &result)) {                                                                                \
            fail(BEYOND);                                                                                              \
        }                                                                                                              \
        return result;                                                                                                 \
    }
CHECKED_WHOLE(add, __builtin_add_overflow)
CHECKED_WHOLE(sub, __builtin_sub_overflow)
CHECKED_WHOLE(mul, __builtin_mul_overflow)
#define int_add checked_add
#define int_sub checked_sub
#define int_mul checked_mul
#endif

#endif

/* Threads that share a piece of work with the thread that calls, and sleep in between.
 *
 * Each helper has a box. A caller puts its job into the boxes of the helpers, does its own share, and takes back what
 * no helper has begun: nobody waits for a thread that is late, or that works for another caller. A helper looks for the
 * next job for a while before it sleeps, since to wake it takes longer than a small job. */
#ifndef BELTARM_POOL_H
#define BELTARM_POOL_H

#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
typedef SRWLOCK Lock;
typedef CONDITION_VARIABLE Bell;
#else
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <time.h>
typedef pthread_mutex_t Lock;
typedef pthread_cond_t Bell;
#endif

enum { MAX_HELPERS = 255, HELPER_STACK = 8 << 20, LINES = 128 /* processors fetch cache lines in pairs */ };
enum { LONG_LOOK = 300000, SHORT_LOOK = 30000, SOON = 1000000 }; /* ns: how long a helper looks, see `serve` */
/* Looks after which a thread that waits lets another one have its core: it may be the one that it waits for */
enum { POLITE = 50 };

typedef void (*Work)(void *with, int thread);
typedef struct {
    Work work;
    void *with;
    int ended; /* shares that helpers have begun and ended */
} Job;

typedef struct {
    char before[LINES];
    Job *offer; /* NULL, a job to be begun, or TAKEN */
    int asleep;
    int thread; /* index of the share that it does */
    Lock lock;
    Bell bell;
    char behind[LINES];
} Helper;

static Job taken;
#define TAKEN (&taken)
static Helper *helpers[MAX_HELPERS]; /* those of this process; written by a thread that holds Python's lock */
static int helper_count;
static bool refused; /* the system allows no more threads */

#ifdef _WIN32
static void acquire(Helper *h) { AcquireSRWLockExclusive(&h->lock); }
static void release(Helper *h) { ReleaseSRWLockExclusive(&h->lock); }
static void await_bell(Helper *h) { SleepConditionVariableSRW(&h->bell, &h->lock, INFINITE, 0); }
static void ring(Helper *h) { WakeConditionVariable(&h->bell); }
static void yield_core(void) { SwitchToThread(); }
static int64_t now(void)
{
    LARGE_INTEGER count, frequency;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&frequency);
    return (int64_t)((double)count.QuadPart * 1e9 / (double)frequency.QuadPart);
}
#else
static void acquire(Helper *h) { pthread_mutex_lock(&h->lock); }
static void release(Helper *h) { pthread_mutex_unlock(&h->lock); }
static void await_bell(Helper *h) { pthread_cond_wait(&h->bell, &h->lock); }
static void ring(Helper *h) { pthread_cond_signal(&h->bell); }
static void yield_core(void) { sched_yield(); }
static int64_t now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}
#endif

/* Wait for a moment. */
static void pause_core(int looks)
{
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("isb"); /* `yield` takes no time on most cores */
#endif
    if (looks % POLITE == 0) yield_core();
}

/* Replace what is in a box, if it is still `before`. */
static bool exchange(Job **offer, Job *before, Job *after)
{
    return __atomic_compare_exchange_n(offer, &before, after, false, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST);
}

/* Do jobs, for ever. Where calls follow each other quickly, a helper that was woken stays awake for longer. */
static void serve(Helper *h)
{
    int64_t patience = SHORT_LOOK;
    for (;;) {
        int64_t since = now();
        for (int looks = 1; looks % POLITE != 0 || now() - since < patience; ++looks) {
            Job *job = __atomic_load_n(&h->offer, __ATOMIC_ACQUIRE);
            if (job != NULL && job != TAKEN && exchange(&h->offer, job, TAKEN)) {
                job->work(job->with, h->thread);
                __atomic_store_n(&h->offer, NULL, __ATOMIC_RELEASE);
                __atomic_fetch_add(&job->ended, 1, __ATOMIC_RELEASE); /* from here on the job may be gone */
                since = now();
                looks = 0;
            } else {
                pause_core(looks);
            }
        }
        acquire(h);
        __atomic_store_n(&h->asleep, 1, __ATOMIC_SEQ_CST);
        if (__atomic_load_n(&h->offer, __ATOMIC_SEQ_CST) != NULL) __atomic_store_n(&h->asleep, 0, __ATOMIC_RELAXED);
        since = now();
        while (__atomic_load_n(&h->asleep, __ATOMIC_RELAXED)) await_bell(h);
        release(h);
        patience = now() - since < SOON ? LONG_LOOK : SHORT_LOOK;
    }
}

/* Wake a helper, which then looks for a job for a while even if this one is taken back before it comes to it. */
static void wake(Helper *h)
{
    if (!__atomic_load_n(&h->asleep, __ATOMIC_SEQ_CST)) return;
    acquire(h);
    __atomic_store_n(&h->asleep, 0, __ATOMIC_RELAXED);
    ring(h);
    release(h);
}

#ifdef _WIN32
static DWORD WINAPI begin(LPVOID helper)
{
    serve(helper);
    return 0;
}
static bool start(Helper *h)
{
    InitializeSRWLock(&h->lock);
    InitializeConditionVariable(&h->bell);
    HANDLE thread = CreateThread(NULL, HELPER_STACK, begin, h, STACK_SIZE_PARAM_IS_A_RESERVATION, NULL);
    if (thread != NULL) CloseHandle(thread);
    return thread != NULL;
}
#else
static void *begin(void *helper)
{
    serve(helper);
    return NULL;
}
/* In a process that was forked there are no helpers. Their locks may be held by nobody: they are not used again. */
static void forget_helpers(void)
{
    helper_count = 0;
    refused = false;
}
static bool start(Helper *h)
{
    static bool prepared;
    sigset_t all, before;
    pthread_attr_t attributes;
    pthread_t thread;
    if (!prepared && pthread_atfork(NULL, NULL, forget_helpers) != 0) return false;
    prepared = true;
    if (pthread_attr_init(&attributes) != 0) return false;
    pthread_mutex_init(&h->lock, NULL);
    pthread_cond_init(&h->bell, NULL);
    pthread_attr_setdetachstate(&attributes, PTHREAD_CREATE_DETACHED);
    pthread_attr_setstacksize(&attributes, HELPER_STACK); /* the same everywhere; some systems give 128 kB */
    sigfillset(&all); /* signals are for Python's threads */
    pthread_sigmask(SIG_SETMASK, &all, &before);
    bool started = pthread_create(&thread, &attributes, begin, h) == 0;
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    pthread_attr_destroy(&attributes);
    return started;
}
#endif

/* Return how many helpers there are for so many threads, and start those that are missing. Needs Python's lock. */
static int ready_helpers(int threads)
{
    int wanted = threads - 1 < MAX_HELPERS ? threads - 1 : MAX_HELPERS;
    while (helper_count < wanted && !refused) {
        Helper *h = calloc(1, sizeof(Helper));
        if (h != NULL) h->thread = helper_count + 1;
        if (h == NULL || !start(h)) {
            free(h);
            refused = true;
            break;
        }
        helpers[helper_count++] = h;
    }
    return helper_count < wanted ? helper_count : wanted;
}

/* Do a piece of work in several shares, in this thread and in so many helpers, until all shares are done.
 * This thread does the first share, and those that no helper has begun by then. Needs no lock of Python's. */
static void share_work(Work work, void *with, int threads, int helped)
{
    Job job = {work, with, 0};
    bool offered[MAX_HELPERS];
    int begun = 0;
    for (int k = 0; k < helped; ++k) offered[k] = exchange(&helpers[k]->offer, NULL, &job);
    for (int k = 0; k < helped; ++k) {
        if (offered[k]) wake(helpers[k]);
    }
    work(with, 0);
    for (int k = 0; k < threads - 1; ++k) {
        if (k < helped && offered[k] && !exchange(&helpers[k]->offer, &job, NULL)) ++begun;
        else work(with, k + 1);
    }
    for (int looks = 1; __atomic_load_n(&job.ended, __ATOMIC_ACQUIRE) < begun; ++looks) pause_core(looks);
}

#endif

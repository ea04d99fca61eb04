// A futex ring of four processes on one CPU that touch pages of memory before they wake the next one.
//
//   ring PAGES   prints the time from the first process's start to the last one's end, in microseconds
//
// Every tick of 1 ms is preceded by a lap that is not measured, as in a flight. Needs root for SCHED_FIFO.
#define _GNU_SOURCE
#include <linux/futex.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { STAGES = 4, TICKS = 4000, PAGE = 4096, LINE = 64, PERIOD_NS = 1000000, LEAD_NS = 150000 };

struct shared {
    struct { _Alignas(LINE) uint32_t count; } event[STAGES];
    int64_t begun_ns, lap_ns[TICKS];
};

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static void wait_for(uint32_t *count, uint32_t seen) {
    while (__atomic_load_n(count, __ATOMIC_SEQ_CST) == seen)
        syscall(SYS_futex, count, FUTEX_WAIT, seen, NULL, NULL, 0);
}

static void notify(uint32_t *count) {
    __atomic_add_fetch(count, 1, __ATOMIC_SEQ_CST);
    syscall(SYS_futex, count, FUTEX_WAKE, 1, NULL, NULL, 0);
}

static int by_size(const void *a, const void *b) {
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

int main(int argc, char **argv) {
    size_t pages = argc == 2 ? strtoul(argv[1], NULL, 10) : 0, bytes = (pages + 1) * PAGE;
    struct shared *shared =
        mmap(NULL, sizeof *shared, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    int stage = 0;
    for (int next = 1; next < STAGES && stage == 0; next++)
        if (fork() == 0) stage = next;

    volatile char *memory = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    madvise((void *)memory, bytes, MADV_NOHUGEPAGE);
    for (size_t at = 0; at < bytes; at += PAGE) memory[at] = 1;
    cpu_set_t cpus;
    CPU_ZERO(&cpus);
    CPU_SET(sysconf(_SC_NPROCESSORS_ONLN) - 1, &cpus);
    struct sched_param priority = {.sched_priority = 80 + stage};
    if (sched_setaffinity(0, sizeof cpus, &cpus) || mlockall(MCL_CURRENT) ||
        sched_setscheduler(0, SCHED_FIFO, &priority)) {
        perror("SCHED_FIFO, locked memory and the last CPU are needed");
        return 1;
    }
    int64_t tick_ns = now_ns() + 20 * PERIOD_NS;
    for (uint32_t lap = 0; lap < 2 * TICKS; lap++) {
        int is_measured = lap % 2;
        if (stage == 0 && !is_measured) {
            int64_t early_ns = tick_ns - LEAD_NS;
            struct timespec at = {early_ns / 1000000000, early_ns % 1000000000};
            clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
        } else if (stage == 0) {
            while (now_ns() < tick_ns) {}
            tick_ns += PERIOD_NS;
        } else {
            wait_for(&shared->event[stage].count, lap);
        }
        if (stage == 0) shared->begun_ns = now_ns();
        // Another cache line in each page: it is pages that are compared.
        for (size_t page = 0; page < pages; page++) (void)memory[page * PAGE + page * LINE % PAGE];
        if (stage < STAGES - 1)
            notify(&shared->event[stage + 1].count);
        else if (is_measured)
            shared->lap_ns[lap / 2] = now_ns() - shared->begun_ns;
    }
    if (stage > 0) return 0;
    while (wait(NULL) > 0) {}
    qsort(shared->lap_ns, TICKS, sizeof *shared->lap_ns, by_size);
    printf("%zu pages per process: p50 %.2f us, p99 %.2f us\n", pages, shared->lap_ns[TICKS / 2] / 1e3,
           shared->lap_ns[TICKS / 100 * 99] / 1e3);
}

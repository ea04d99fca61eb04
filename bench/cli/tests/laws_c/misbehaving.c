// An inner law that flies, and from a tick on does what no law should: what its setting `misbehave` says.

#define _GNU_SOURCE
#include "ironbird_law.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { MISBEHAVE, FROM_TICK, SETTINGS };
enum { NOTHING, CRASH, ABORT, EXIT, OVERFLOW, LOOP, NAN_TORQUE, SLEEP, ALLOCATE, FAULT, REFUSE, CRASH_WHEN_MADE,
       CRASH_WHEN_COPIED, CRASH_WHEN_FREED, SLOW, REFUSE_WITH_FILE, FLIP, LOOP_IN_A };
static const char *const WORDS[] = {"nothing", "crash",    "abort", "exit",   "overflow",       "loop", "nan",
                                    "sleep",   "allocate", "fault", "refuse", "crash_when_made",
                                    "crash_when_copied", "crash_when_freed", "slow", "refuse_with_file", "flip", "loop_in_a"};
static const IronbirdSetting settings[SETTINGS] = {
    [MISBEHAVE] = {.name = "misbehave", .meaning = "what to do wrong", .kind = IRONBIRD_WORD, .words = WORDS,
                   .words_count = sizeof WORDS / sizeof *WORDS},
    [FROM_TICK] = {.name = "from_tick", .meaning = "when", .kind = IRONBIRD_NUMBER, .max = 1e9},
};

typedef struct {
    IronbirdRig rig;
    uint64_t misbehave;
    uint64_t from_tick;
    // Whether this process is in channel b.
    uint64_t is_b;
} Law;

static volatile uint64_t sink;

static uint64_t is_in_channel_b(void)
{
    char line[4096];
    FILE *file = fopen("/proc/self/cmdline", "r");
    const size_t length = file == NULL ? 0 : fread(line, 1, sizeof line, file);
    if (file != NULL)
        fclose(file);
    return memmem(line, length, "--channel=b", sizeof "--channel=b") != NULL;
}

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size)
{
    (void)context;
    if (values[MISBEHAVE].word == REFUSE) {
        snprintf(refused, size, "misbehave = refuse and from_tick = %g do not go together", values[FROM_TICK].number[0]);
        return NULL;
    }
    if (values[MISBEHAVE].word == REFUSE_WITH_FILE) {
        FILE *file = fopen("refuse", "r");
        if (file != NULL) {
            fclose(file);
            snprintf(refused, size, "there is a file named refuse");
            return NULL;
        }
    }
    if (values[MISBEHAVE].word == CRASH_WHEN_MADE)
        sink = *(volatile uint64_t *)NULL;
    Law *law = calloc(1, sizeof *law);
    if (law != NULL)
        *law = (Law){*rig, values[MISBEHAVE].word, (uint64_t)values[FROM_TICK].number[0], is_in_channel_b()};
    return law;
}

static void copy_into(const void *law, void *other)
{
    if (((const Law *)law)->misbehave == CRASH_WHEN_COPIED)
        sink = *(volatile uint64_t *)NULL;
    memcpy(other, law, sizeof(Law));
}

// All but the channel.
static uint64_t save(const void *law, void *bytes, uint64_t size)
{
    if (size < offsetof(Law, is_b))
        return 0;
    memcpy(bytes, law, offsetof(Law, is_b));
    return offsetof(Law, is_b);
}

static uint64_t load(void *law, const void *bytes, uint64_t size)
{
    if (size != offsetof(Law, is_b))
        return 0;
    memcpy(law, bytes, size);
    return 1;
}

static void destroy(void *law)
{
    if (((Law *)law)->misbehave == CRASH_WHEN_FREED)
        sink = *(volatile uint64_t *)NULL;
    free(law);
}

static uint64_t overflow(uint64_t depth)
{
    volatile uint64_t room[512];
    room[depth % 512] = depth;
    return sink == depth ? 0 : room[depth % 512] + overflow(depth + 1) + room[0];
}

// Computes for 2.4 ms.
static void compute(void)
{
    struct timespec begin, now;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    do
        clock_gettime(CLOCK_MONOTONIC, &now);
    while ((now.tv_sec - begin.tv_sec) * 1000000000 + now.tv_nsec - begin.tv_nsec < 2400000);
}

static void misbehave(uint64_t how, IronbirdDemand *out)
{
    const struct timespec pause = {.tv_nsec = 3000000};
    switch (how) {
    case CRASH: sink = *(volatile uint64_t *)NULL; break;
    case ABORT: abort();
    case EXIT: exit(0);
    case OVERFLOW: sink = overflow(1); break;
    case LOOP:
        // At normal priority, it leaves the processor to other tests.
        (void)!nice(19);
        for (;;)
            sink++;
    case NAN_TORQUE: out->torque_b_nm[1] = NAN; break;
    case SLOW: compute(); break;
    case SLEEP: nanosleep(&pause, NULL); break;
    case ALLOCATE: {
        char *volatile memory = malloc(100);
        free(memory);
        break;
    }
    case FAULT: {
        char *page = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        if (page != MAP_FAILED) {
            page[0] = 1;
            munmap(page, 4096);
        }
        break;
    }
    }
}

static void tick(void *instance, const IronbirdInnerInput *in, IronbirdDemand *out, IronbirdTelemetry *shown)
{
    Law *law = instance;
    out->thrust_n = in->wanted.thrust_n;
    for (int i = 0; i < 3; i++) {
        const double error = in->wanted.attitude_rad[i] - in->measured.attitude_rad[i];
        out->torque_b_nm[i] = law->rig.airframe.inertia_kg_m2[i] * 60 * (6 * error - in->measured.rate_b_rad_s[i]);
    }
    shown->value[0] = (double)in->tick;
    if (law->misbehave == FLIP && law->is_b && in->tick == law->from_tick)
        // A bit of a gain, from the next tick on.
        ((unsigned char *)&law->rig.airframe.inertia_kg_m2[0])[3] ^= 1;
    if (law->misbehave == LOOP_IN_A && !law->is_b && in->tick == law->from_tick)
        misbehave(LOOP, out);
    if (in->tick >= law->from_tick)
        misbehave(law->misbehave, out);
}

static const IronbirdSignal telemetry[] = {{"asked_at", ""}};
static const IronbirdLaw law = {
    .interface_version = IRONBIRD_LAW_INTERFACE, .sizes = IRONBIRD_SIZES, .role = IRONBIRD_INNER,
    .name = "misbehaving", .version = "1", .summary = "does what no law should", .settings = settings,
    .settings_count = SETTINGS, .telemetry = telemetry, .telemetry_count = 1,
    .create = create, .destroy = destroy, .copy_into = copy_into, .save = save, .load = load, .tick_inner = tick,
};

const IronbirdLaw *ironbird_law(void)
{
    return &law;
}

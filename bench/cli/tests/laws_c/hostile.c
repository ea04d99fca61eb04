// An inner law that flies, and from a tick on, or outside of its ticks, works against the rig: its setting `harm` says how.

#define _GNU_SOURCE
#include "ironbird_law.h"

#include <fenv.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

// What a test compiles in does harm without settings.
#ifndef ALWAYS
#define ALWAYS values[HARM].word
#endif

enum { HARM, FROM_TICK, LEVEL, SETTINGS };
enum { NOTHING, EXIT, QUICK_EXIT, RAW_EXIT, THREAD_EXIT, BLOCK_AND_LOOP, ROUND, TRAP, RAISE, SHOW, FORK, FORK_AWAY,
       EXIT_WHEN_MADE, WAIT_WHEN_MADE, EXIT_WHEN_FREED, CRASH_AT_EXIT, THREAD,
       FORK_WHEN_MADE, ALARM_WHEN_MADE, SLOW_WHEN_MADE, EXEC,
       TRUNCATE };
static const char *const WORDS[] = {"nothing", "exit", "quick_exit", "raw_exit", "thread_exit", "block_and_loop",
                                    "round", "trap", "raise", "show", "fork", "fork_away",
                                    "exit_when_made", "wait_when_made", "exit_when_freed", "crash_at_exit", "thread",
                                    "fork_when_made", "alarm_when_made", "slow_when_made",
                                    "exec", "truncate"};
static const char *const LEVELS[] = {"1", "2.5", "2024-01-01"};
static const IronbirdSetting settings[SETTINGS] = {
    [HARM] = {.name = "harm", .meaning = "what to do", .kind = IRONBIRD_WORD, .words = WORDS,
              .words_count = sizeof WORDS / sizeof *WORDS},
    [FROM_TICK] = {.name = "from_tick", .meaning = "when", .kind = IRONBIRD_NUMBER, .max = 1e9},
    [LEVEL] = {.name = "level", .meaning = "words that look like numbers", .kind = IRONBIRD_WORD, .words = LEVELS,
               .words_count = sizeof LEVELS / sizeof *LEVELS},
};

typedef struct {
    IronbirdRig rig;
    uint64_t harm;
    uint64_t from_tick;
} Law;

static volatile uint64_t sink;
static volatile double zero;

static void crash(void)
{
    sink = *(volatile uint64_t *)NULL;
}

static void *crash_aside(void *nothing)
{
    crash();
    return nothing;
}

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size)
{
    (void)context, (void)refused, (void)size;
    const uint64_t harm = ALWAYS;
    if (harm == FORK_WHEN_MADE && fork() == 0) {
        sleep(20);
        _exit(0);
    }
    if (harm == EXIT_WHEN_MADE)
        _exit(0);
    if (harm == SLOW_WHEN_MADE)
        sleep(20);
    if (harm == ALARM_WHEN_MADE)
        raise(SIGALRM);
    while (harm == WAIT_WHEN_MADE)
        sleep(1);
    if (harm == CRASH_AT_EXIT)
        atexit(crash);
    Law *law = calloc(1, sizeof *law);
    if (law != NULL)
        *law = (Law){*rig, harm, (uint64_t)values[FROM_TICK].number[0]};
    return law;
}

static void destroy(void *law)
{
    if (((Law *)law)->harm == EXIT_WHEN_FREED)
        exit(0);
    free(law);
}

static void copy_into(const void *law, void *other)
{
    memcpy(other, law, sizeof(Law));
}

static void leave_child(void)
{
    if (fork() == 0) {
        sleep(20);
        _exit(0);
    }
}

static void leave_child_of_its_own(void)
{
    if (fork() == 0) {
        setsid();
        sleep(8);
        _exit(0);
    }
}

static void harm(const Law *law, uint64_t tick, IronbirdTelemetry *shown)
{
    sigset_t all;
    pthread_t thread;
    switch (law->harm) {
    case EXIT: _exit(0);
    case QUICK_EXIT: quick_exit(0);
    case RAW_EXIT: syscall(SYS_exit_group, 0); break;
    case EXEC: execl("/bin/sleep", "sleep", "60", (char *)NULL); break;
    case TRUNCATE:
        for (int file = 3; file < 256; file++)
            if (ftruncate(file, 0) != 0)
                continue;
        break;
    case THREAD_EXIT: pthread_exit(NULL);
    case BLOCK_AND_LOOP:
        sigfillset(&all);
        sigprocmask(SIG_BLOCK, &all, NULL);
        for (;;)
            sink++;
    case ROUND: fesetround(FE_UPWARD); break;
    case TRAP:
        feenableexcept(FE_DIVBYZERO);
        shown->value[0] = 1 / zero;
        break;
    case THREAD:
        if (pthread_create(&thread, NULL, crash_aside, NULL) == 0)
            pthread_join(thread, NULL);
        break;
    case RAISE: raise(SIGSEGV); break;
    case SHOW:
        shown->value[0] = tick % 2 ? 1e308 : -1e308;
        shown->value[1] = INFINITY;
        break;
    case FORK:
        if (tick == law->from_tick)
            leave_child();
        break;
    case FORK_AWAY:
        if (tick == law->from_tick)
            leave_child_of_its_own();
        break;
    }
}

static void tick(void *instance, const IronbirdInnerInput *in, IronbirdDemand *out, IronbirdTelemetry *shown)
{
    const Law *law = instance;
    out->thrust_n = in->wanted.thrust_n;
    for (int i = 0; i < 3; i++) {
        const double error = in->wanted.attitude_rad[i] - in->measured.attitude_rad[i];
        out->torque_b_nm[i] = law->rig.airframe.inertia_kg_m2[i] * 60 * (6 * error - in->measured.rate_b_rad_s[i]);
    }
    if (in->tick >= law->from_tick)
        harm(law, in->tick, shown);
}

static const IronbirdSignal telemetry[] = {{"large", ""}, {"endless", ""}};
static const IronbirdLaw law = {
    .interface_version = IRONBIRD_LAW_INTERFACE, .sizes = IRONBIRD_SIZES, .role = IRONBIRD_INNER,
    .name = "hostile", .version = "1", .summary = "works against the rig", .settings = settings,
    .settings_count = SETTINGS, .telemetry = telemetry, .telemetry_count = 2,
    .create = create, .destroy = destroy, .copy_into = copy_into, .tick_inner = tick,
};

const IronbirdLaw *ironbird_law(void)
{
    return &law;
}

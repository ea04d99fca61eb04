// ring TRANSPORT TICKS PERIOD_US PRIORITY CPU CHECK: passes messages around a ring of four processes, and prints one line of JSON.
//
//   plant -> outer -> inner -> mixer -> plant, which waits for its next tick (PERIOD_US 0: sends again at once)
//   |<---------- loop ------------->|
//
// TRANSPORT is a name of `kernel` below, or LIBRARY.so:VARIANT with the functions of ring.h. CHECK 1 fills every message with numbers
// that depend on its tick and compares all of them in every stage, in the place of computing.
#define _GNU_SOURCE
#include "ring.h"
#include <arpa/inet.h>
#include <dlfcn.h>
#include <errno.h>
#include <linux/futex.h>
#include <mqueue.h>
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { WARM_UP = 300, COMPUTE_NS = 1000, SETTLE_US = 1000000, HANGS_S = 20 };

typedef struct {
    const char *name;
    // Opens all links before the processes start; a library's are opened in each process.
    void (*prepare)(void);
    void (*send)(int stage, const Message *message);
    void (*receive)(int stage, Message *message);
} Transport;

static struct {
    _Atomic int ready, finished, without_fifo;
    uint64_t cpu_ns[STAGES], elapsed_ns;
    struct { _Alignas(64) _Atomic uint32_t sent; Message message; } slot[STAGES];
    uint32_t loop_ns[];
} *shared;
static int computed;

static void fail(const char *what) {
    fprintf(stderr, "error: %s: %s\n", what, errno ? strerror(errno) : "failed");
    exit(1);
}
static void need(int holds, const char *what) { if (!holds) fail(what); }
static int before(int stage) { return (stage + STAGES - 1) % STAGES; }
static uint64_t clock_ns(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * 1000000000ull + t.tv_nsec;
}
static uint64_t now_ns(void) { return clock_ns(CLOCK_MONOTONIC); }

// Futex: the message in shared memory, and a counter to wait for.
static void none(void) {}
static uint32_t received;
static void futex_send(int stage, const Message *message) {
    shared->slot[stage].message = *message;
    atomic_fetch_add(&shared->slot[stage].sent, 1);
    syscall(SYS_futex, &shared->slot[stage].sent, FUTEX_WAKE, 1, NULL, NULL, 0);
}
static void futex_receive(int stage, Message *message) {
    _Atomic uint32_t *sent = &shared->slot[before(stage)].sent;
    while (atomic_load(sent) == received) syscall(SYS_futex, sent, FUTEX_WAIT, received, NULL, NULL, 0);
    received++;
    *message = shared->slot[before(stage)].message;
}
// Everything that is a pair of descriptors: one end to read from, one to write to.
static int ends[STAGES][2];
static void send_bytes(int stage, const Message *message) {
    need(write(ends[stage][1], message, sizeof *message) == sizeof *message, "write");
}
static void receive_bytes(int stage, Message *message) {
    need(read(ends[before(stage)][0], message, sizeof *message) == sizeof *message, "read");
}
static void pipes(void) { for (int i = 0; i < STAGES; i++) need(!pipe(ends[i]), "pipe"); }
static void datagrams(void) {
    for (int i = 0; i < STAGES; i++) need(!socketpair(AF_UNIX, SOCK_DGRAM, 0, ends[i]), "socketpair");
}
static void udp(void) {
    for (int i = 0; i < STAGES; i++) {
        struct sockaddr_in at = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
        socklen_t length = sizeof at;
        for (int end = 0; end < 2; end++) need((ends[i][end] = socket(AF_INET, SOCK_DGRAM, 0)) >= 0, "socket");
        need(!bind(ends[i][0], (void *)&at, length) && !getsockname(ends[i][0], (void *)&at, &length), "bind");
        need(!connect(ends[i][1], (void *)&at, length), "connect");
    }
}
// Eventfd: the message in shared memory, as for the futex.
static void eventfds(void) {
    for (int i = 0; i < STAGES; i++) need((ends[i][0] = eventfd(0, 0)) >= 0, "eventfd");
}
static void eventfd_send(int stage, const Message *message) {
    shared->slot[stage].message = *message;
    need(!eventfd_write(ends[stage][0], 1), "eventfd_write");
}
static void eventfd_receive(int stage, Message *message) {
    eventfd_t count;
    need(!eventfd_read(ends[before(stage)][0], &count), "eventfd_read");
    *message = shared->slot[before(stage)].message;
}
static void queues(void) {
    struct mq_attr attributes = {.mq_maxmsg = 8, .mq_msgsize = sizeof(Message)};
    for (int i = 0; i < STAGES; i++) {
        char name[64];
        snprintf(name, sizeof name, "/ring-%d-%d", getpid(), i);
        need((ends[i][0] = mq_open(name, O_RDWR | O_CREAT | O_EXCL, 0600, &attributes)) >= 0, "mq_open");
        mq_unlink(name);
    }
}
static void queue_send(int stage, const Message *message) {
    need(!mq_send(ends[stage][0], (const char *)message, sizeof *message, 0), "mq_send");
}
static void queue_receive(int stage, Message *message) {
    need(mq_receive(ends[before(stage)][0], (char *)message, sizeof *message, NULL) == sizeof *message, "mq_receive");
}

static const Transport kernel[] = {
    {"futex", none, futex_send, futex_receive},
    {"eventfd", eventfds, eventfd_send, eventfd_receive},
    {"pipe", pipes, send_bytes, receive_bytes},
    {"queue", queues, queue_send, queue_receive},
    {"unix", datagrams, send_bytes, receive_bytes},
    {"udp", udp, send_bytes, receive_bytes},
};

static void fill(Message *message, uint64_t tick) {
    for (int i = 0; i < 98; i++) message->data[i] = (double)(tick * 98 + i);
}
// A chain of dependent operations on the message: a fixed amount of work, which a preemption prolongs.
__attribute__((noinline)) static void compute(Message *message, int iterations) {
    double x = message->data[0], y = message->data[1];
    for (int i = 0; i < iterations; i++) {
        x = x * 0.999 + y;
        y = y * 0.5 + message->data[2 + (i & 63)];
    }
    message->data[0] = x;
    message->data[1] = y;
}
// How many iterations take COMPUTE_NS: the best of some trials.
static int calibrated(void) {
    Message message;
    fill(&message, 1);
    uint64_t best_ns = UINT64_MAX;
    for (int trial = 0; trial < 20; trial++) {
        uint64_t start_ns = now_ns();
        compute(&message, 20000);
        uint64_t took_ns = now_ns() - start_ns;
        if (took_ns < best_ns) best_ns = took_ns;
    }
    return (int)(COMPUTE_NS * 20000ull / best_ns);
}

static void take_stand(int priority, int cpu) {
    cpu_set_t set;
    CPU_ZERO(&set);
    CPU_SET(cpu, &set);
    need(!sched_setaffinity(0, sizeof set, &set), "sched_setaffinity");
    struct sched_param parameters = {.sched_priority = priority};
    if (priority && (sched_setscheduler(0, SCHED_FIFO, &parameters) || mlockall(MCL_CURRENT | MCL_FUTURE)))
        shared->without_fifo = 1;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
}

static void expect(const Message *message, uint64_t tick, int is_check, int stage) {
    int is_whole = message->tick == tick;
    for (int i = 0; is_check && i < 98; i++) is_whole &= message->data[i] == (double)(tick * 98 + i);
    if (is_whole) return;
    fprintf(stderr, "error: stage %d received message %lu in the place of %lu, or one with another content\n", stage,
            message->tick, tick);
    exit(1);
}

static void run_stage(const Transport *transport, int stage, uint64_t ticks, uint64_t period_ns, int is_check) {
    uint64_t last = ticks + WARM_UP, cpu_ns = 0, start_ns = 0;
    Message message = {0};
    fill(&message, 1);
    atomic_fetch_add(&shared->ready, 1);
    while (stage == 0 && atomic_load(&shared->ready) < STAGES) usleep(1000);
    // No event says that every library has found its peers.
    if (stage == 0 && !transport->prepare) usleep(SETTLE_US);
    uint64_t begin_ns = now_ns() + 20000000;
    for (uint64_t tick = 0; tick < last; tick++) {
        uint64_t due_ns = begin_ns + tick * period_ns;
        struct timespec due = {due_ns / 1000000000, due_ns % 1000000000};
        if (stage == 0 && period_ns) while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL)) {}
        if (stage > 0 || tick > 0) {
            transport->receive(stage, &message);
            expect(&message, stage > 0 ? tick : tick - 1, is_check, stage);
        }
        if (tick == WARM_UP) cpu_ns = clock_ns(CLOCK_PROCESS_CPUTIME_ID), start_ns = now_ns();
        if (!is_check) compute(&message, computed);
        if (stage == 0) {
            if (is_check) fill(&message, tick);
            message.tick = tick;
            message.sampled_ns = now_ns();
        }
        if (stage == STAGES - 1 && tick >= WARM_UP) shared->loop_ns[tick - WARM_UP] = now_ns() - message.sampled_ns;
        transport->send(stage, &message);
    }
    if (stage == 0) {
        transport->receive(stage, &message);
        expect(&message, last - 1, is_check, stage);
        shared->elapsed_ns = now_ns() - start_ns;
    }
    shared->cpu_ns[stage] = clock_ns(CLOCK_PROCESS_CPUTIME_ID) - cpu_ns;
    // A library that closes takes what was not yet received with it.
    atomic_fetch_add(&shared->finished, 1);
    while (atomic_load(&shared->finished) < STAGES) usleep(1000);
}

static int by_size(const void *a, const void *b) {
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

int main(int count, char **words) {
    need(count == 7, "usage: ring TRANSPORT TICKS PERIOD_US PRIORITY CPU CHECK");
    uint64_t ticks = strtoull(words[2], NULL, 10), period_ns = strtoull(words[3], NULL, 10) * 1000;
    int priority = atoi(words[4]), cpu = atoi(words[5]), is_check = atoi(words[6]);
    const Transport *transport = NULL;
    for (size_t i = 0; i < sizeof kernel / sizeof *kernel; i++)
        if (!strcmp(kernel[i].name, words[1])) transport = &kernel[i];
    char *variant = strchr(words[1], ':');
    need(transport || variant, "TRANSPORT is no name of the kernel's and no LIBRARY.so:VARIANT");
    need(ticks > 0, "TICKS is 0");
    size_t bytes = sizeof *shared + ticks * sizeof(uint32_t);
    shared = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS | MAP_POPULATE, -1, 0);
    need(shared != MAP_FAILED, "mmap");
    computed = calibrated();
    if (transport) transport->prepare();
    if (variant) *variant++ = 0;
    unsigned run = getpid();
    pid_t processes[STAGES];
    for (int i = 0; i < STAGES; i++) {
        if ((processes[i] = fork())) continue;
        take_stand(priority ? priority + i : 0, cpu);
        alarm(ticks * period_ns / 1000000000 + HANGS_S);
        if (transport) {
            run_stage(transport, i, ticks, period_ns, is_check);
            _exit(0);
        }
        void *library = dlopen(words[1], RTLD_NOW);
        if (!library) fprintf(stderr, "error: %s\n", dlerror()), exit(1);
        Transport loaded = {variant, NULL, dlsym(library, "ring_send"), dlsym(library, "ring_receive")};
        ((typeof(&ring_open))dlsym(library, "ring_open"))(variant, i, run);
        run_stage(&loaded, i, ticks, period_ns, is_check);
        ((typeof(&ring_close))dlsym(library, "ring_close"))(i);
        _exit(0);
    }
    for (int i = 0; i < STAGES; i++) {
        int status;
        waitpid(-1, &status, 0);
        if (!status) continue;
        for (int j = 0; j < STAGES; j++) kill(processes[j], SIGKILL);
        if (WIFSIGNALED(status) && WTERMSIG(status) == SIGALRM) fputs("error: a message was lost: a stage waited in vain\n", stderr);
        else if (WIFSIGNALED(status)) fprintf(stderr, "error: a stage was ended by signal %d\n", WTERMSIG(status));
        return 1;
    }
    uint64_t cpu_ns = 0;
    for (int i = 0; i < STAGES; i++) cpu_ns += shared->cpu_ns[i];
    qsort(shared->loop_ns, ticks, sizeof(uint32_t), by_size);
    const char *fifo = shared->without_fifo || !priority ? "false" : "true";
    printf("{\"fifo\": %s, \"ticks\": %lu, \"cpu_us\": %.3f, \"lap_us\": %.3f", fifo, ticks, cpu_ns / 1e3 / ticks,
           shared->elapsed_ns / 1e3 / ticks);
    static const struct { const char *name; double share; } quantiles[] = {{"p50", 0.5}, {"p99", 0.99}, {"p999", 0.999}};
    for (int i = 0; i < 3; i++)
        printf(", \"%s_us\": %.3f", quantiles[i].name, shared->loop_ns[(uint64_t)(quantiles[i].share * ticks)] / 1e3);
    puts("}");
    return 0;
}

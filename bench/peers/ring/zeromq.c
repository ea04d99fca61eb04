// ZeroMQ over its local transport: variant `push` (PUSH to PULL) or `publish` (PUB to SUB).
#include "ring.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zmq.h>

static void *context, *out, *in;

static void need(int holds) {
    if (holds) return;
    fprintf(stderr, "error: ZeroMQ: %s\n", zmq_strerror(zmq_errno()));
    exit(1);
}

void ring_open(const char *variant, int stage, unsigned run) {
    int is_published = !strcmp(variant, "publish");
    char to[64], from[64];
    snprintf(to, sizeof to, "ipc://@ring-%u-%d", run, stage);
    snprintf(from, sizeof from, "ipc://@ring-%u-%d", run, (stage + STAGES - 1) % STAGES);
    context = zmq_ctx_new();
    out = zmq_socket(context, is_published ? ZMQ_PUB : ZMQ_PUSH);
    in = zmq_socket(context, is_published ? ZMQ_SUB : ZMQ_PULL);
    need(!zmq_bind(out, to));
    need(!is_published || !zmq_setsockopt(in, ZMQ_SUBSCRIBE, "", 0));
    need(!zmq_connect(in, from));
}
void ring_send(int stage, const Message *message) {
    (void)stage;
    need(zmq_send(out, message, sizeof *message, 0) == sizeof *message);
}
void ring_receive(int stage, Message *message) {
    (void)stage;
    need(zmq_recv(in, message, sizeof *message, 0) == sizeof *message);
}
void ring_close(int stage) { (void)stage; }

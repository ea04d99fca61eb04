// Cyclone DDS with its defaults for an order of messages: best effort, the last one is kept.
#include "Sample.h"
#include "ring.h"
#include <dds/dds.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

_Static_assert(sizeof(Sample) == sizeof(Message), "Sample.idl describes Message");
static dds_entity_t writer, reader, waitset;

static dds_entity_t need(dds_entity_t result) {
    if (result >= 0) return result;
    fprintf(stderr, "error: Cyclone DDS: %s\n", dds_strretcode(result));
    exit(1);
}

void ring_open(const char *variant, int stage, unsigned run) {
    (void)variant;
    dds_entity_t participant = need(dds_create_participant(DDS_DOMAIN_DEFAULT, NULL, NULL)), topics[2];
    dds_qos_t *quality = dds_create_qos();
    dds_qset_reliability(quality, DDS_RELIABILITY_BEST_EFFORT, 0);
    dds_qset_history(quality, DDS_HISTORY_KEEP_LAST, 1);
    for (int i = 0; i < 2; i++) {
        char name[64];
        snprintf(name, sizeof name, "ring_%u_%d", run, (stage + (STAGES - 1) * i) % STAGES);
        topics[i] = need(dds_create_topic(participant, &Sample_desc, name, NULL, NULL));
    }
    writer = need(dds_create_writer(participant, topics[0], quality, NULL));
    reader = need(dds_create_reader(participant, topics[1], quality, NULL));
    waitset = need(dds_create_waitset(participant));
    need(dds_waitset_attach(waitset, need(dds_create_readcondition(reader, DDS_ANY_STATE)), 0));
}
void ring_send(int stage, const Message *message) {
    (void)stage;
    need(dds_write(writer, message));
}
void ring_receive(int stage, Message *message) {
    (void)stage;
    for (int is_there = 0; !is_there;) {
        void *sample = NULL;
        dds_sample_info_t info;
        if (need(dds_take(reader, &sample, &info, 1, 1)) == 0) {
            need(dds_waitset_wait(waitset, NULL, 0, DDS_INFINITY));
            continue;
        }
        if ((is_there = info.valid_data)) memcpy(message, sample, sizeof *message);
        need(dds_return_loan(reader, &sample, 1));
    }
}
void ring_close(int stage) { (void)stage; }

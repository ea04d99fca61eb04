// The interface of a transport library that `ring` loads: four stages, link i leads from stage i to stage (i + 1) % 4.
#include <stdint.h>
#define STAGES 4
typedef struct {
    uint64_t tick, sampled_ns;
    double data[98];
} Message;
_Static_assert(sizeof(Message) == 800, "the size of a message is part of what is measured");

// Called in the process of each stage. `run` is a number that no other ring of this machine has at the same time.
void ring_open(const char *variant, int stage, unsigned run);
void ring_send(int stage, const Message *message);
// Blocks until the message from the stage before is there.
void ring_receive(int stage, Message *message);
void ring_close(int stage);

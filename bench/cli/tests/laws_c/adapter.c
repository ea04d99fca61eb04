// Stands for the library that makes laws of Python files: the file's first line is the thrust factor of an inner law.

#include "ironbird_law.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size)
{
    (void)rig, (void)values, (void)refused, (void)size;
    double *law = malloc(sizeof *law);
    if (law != NULL)
        *law = *(double *)context;
    return law;
}

static void tick(void *law, const IronbirdInnerInput *in, IronbirdDemand *out, IronbirdTelemetry *shown)
{
    (void)shown;
    out->thrust_n = *(double *)law * in->wanted.thrust_n;
    for (int i = 0; i < 3; i++)
        out->torque_b_nm[i] = 0.2 * (in->wanted.attitude_rad[i] - in->measured.attitude_rad[i])
                              - 0.05 * in->measured.rate_b_rad_s[i];
}

const IronbirdLaw *ironbird_law_open(const char *path, char *refused, uint64_t size)
{
    double *factor = malloc(sizeof *factor);
    char *name = malloc(IRONBIRD_NAME_BYTES);
    IronbirdLaw *law = calloc(1, sizeof *law);
    FILE *file = fopen(path, "r");
    if (file == NULL || factor == NULL || name == NULL || law == NULL || fscanf(file, "# %lf", factor) != 1) {
        snprintf(refused, size, "line 1: expected `# FACTOR`");
        return NULL;
    }
    fclose(file);
    // As the file is called.
    snprintf(name, IRONBIRD_NAME_BYTES, "%s", strrchr(path, '/') + 1);
    *strchr(name, '.') = 0;
    *law = (IronbirdLaw){
        .interface_version = IRONBIRD_LAW_INTERFACE, .sizes = IRONBIRD_SIZES, .role = IRONBIRD_INNER,
        .not_real_time = 1, .name = name, .version = "1", .summary = "of a file", .context = factor,
        .create = create, .destroy = free, .tick_inner = tick,
    };
    return law;
}

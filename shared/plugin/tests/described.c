// A law whose table is right, but for what the test that compiles it defines.

#define _GNU_SOURCE
#include "ironbird_law.h"

#include <dlfcn.h>
#include <fenv.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef VERSION
#define VERSION IRONBIRD_LAW_INTERFACE
#endif
#ifndef SIZES
#define SIZES IRONBIRD_SIZES
#endif
#ifndef ROLE
#define ROLE IRONBIRD_OUTER
#endif
#ifndef NAME
#define NAME "described"
#endif
#ifndef SUMMARY
#define SUMMARY "says what it is"
#endif
#ifndef UNIT
#define UNIT "1/s"
#endif
#ifndef GAIN
#define GAIN {.name = "gain_1_s", .unit = UNIT, .meaning = "a gain", .kind = IRONBIRD_NUMBER, .default_number = {2}, .max = 9}
#endif
#ifndef WORDS
#define WORDS "slow", "quick"
#endif
#ifndef SOFT
#define SOFT {{.number = {1, 0.0 / 0.0, 0.0 / 0.0}}, {.number = {4, 5, 6}}, {.word = 1}}
#endif
#ifndef SIGNAL
#define SIGNAL {"error_m", "m"}
#endif
#ifndef SETTINGS
#define SETTINGS 3
#endif
#ifndef TABLE
#define TABLE &law
#endif
#ifndef CREATE
#define CREATE create
#endif
#ifndef TICK
#define TICK tick
#endif
#ifndef LOAD
#define LOAD load
#endif
#ifndef FUNCTION
#define FUNCTION ironbird_law
#endif

static const char *const words[] = {WORDS};
static const IronbirdSetting settings[] = {
    GAIN,
    {.name = "axes", .meaning = "three", .kind = IRONBIRD_THREE, .default_number = {1, 2, 3}, .min = -1, .max = 9},
    {.name = "mode", .meaning = "a word", .kind = IRONBIRD_WORD, .words = words, .words_count = sizeof words / sizeof *words},
};
static const IronbirdValue soft[] = SOFT;
static const IronbirdPreset presets[] = {{"soft", soft}};
static const IronbirdSignal telemetry[] = {SIGNAL, {"speed_m_s", "m/s"}};

// What it was made with, for the test to see.
static IronbirdRig told;
static IronbirdValue given[3];

static void *create(void *context, const IronbirdRig *rig, const IronbirdValue *values, char *refused, uint64_t size)
{
    (void)context, (void)refused, (void)size;
#ifdef ROUNDS
    fesetround(FE_UPWARD);
#endif
    told = *rig;
    for (int i = 0; i < 3; i++)
        given[i] = values[i];
    return calloc(1, sizeof(uint64_t));
}

static void tick(void *law, const IronbirdOuterInput *in, IronbirdWanted *out, IronbirdTelemetry *shown)
{
    *(uint64_t *)law += in->tick;
    shown->value[30] = (double)*(uint64_t *)law;
    out->thrust_n = in->measured.rotor_speed_command_rad_s[3];
    for (int i = 0; i < 3; i++) {
        out->attitude_rad[i] = given[1].number[i];
        out->attitude_rate_rad_s[i] = told.airframe.inertia_kg_m2[i];
        out->attitude_acceleration_rad_s2[i] = in->measured.position_w_m[i];
    }
    out->limited = given[2].word;
    shown->value[0] = given[0].number[0];
    shown->value[1] = told.airframe.motor_time_constant_s;
    shown->value[2] = told.rotor_max_rad_s;
    shown->value[3] = told.period_s;
    shown->value[4] = in->reference.yaw_acceleration_rad_s2;
    shown->value[5] = (double)in->tick;
    shown->value[6] = told.airframe.rotor_efficiency[3];
    shown->value[7] = told.airframe.mass_kg;
    shown->value[31] = in->reference.position_w_m[0];
}

static uint64_t save(const void *law, void *bytes, uint64_t size)
{
    if (size < sizeof(uint64_t))
        return 0;
    memcpy(bytes, law, sizeof(uint64_t));
    return sizeof(uint64_t);
}

static uint64_t load(void *law, const void *bytes, uint64_t size)
{
    if (size != sizeof(uint64_t))
        return 0;
    memcpy(law, bytes, size);
    return 1;
}

static const IronbirdLaw law = {
    .interface_version = VERSION, .sizes = SIZES, .role = ROLE, .name = NAME, .version = "1", .summary = SUMMARY,
    .settings = settings, .settings_count = SETTINGS, .presets = presets, .presets_count = 1,
    .telemetry = telemetry, .telemetry_count = 2, .create = CREATE, .destroy = free,
    .save = save, .load = LOAD, .tick_outer = TICK,
};

#ifdef MISSING
void missing_function(void);
#endif

#ifdef ROUNDS
__attribute__((constructor)) static void round_up(void)
{
    fesetround(FE_UPWARD);
}
#endif

#ifdef GROWS
// As a build does that ends only now.
__attribute__((constructor)) static void grow(void)
{
    Dl_info place;
    FILE *file = dladdr(&law, &place) ? fopen(place.dli_fname, "ab") : NULL;
    if (file != NULL) {
        fputc(0, file);
        fclose(file);
    }
}
#endif

const IronbirdLaw *FUNCTION(void);
const IronbirdLaw *FUNCTION(void)
{
    (void)create, (void)load, (void)tick;
#ifdef MISSING
    missing_function();
#endif
    return TABLE;
}

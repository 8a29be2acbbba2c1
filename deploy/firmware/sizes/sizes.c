/* sizes.c: each part of the kit as a function that firmware would call; sizes.sh builds and measures it. */
#include "magcal.h"
#if PART == 5
#include "magcal_igrf.h"
#endif

void entry(void);
volatile uint8_t line;
static uint8_t frame[MAGCAL_TELEMETRY_FRAME_BYTES];
static magcal_real field_nt[3];

#if PART >= 1 && PART <= 4 /* samples */
static size_t samples(const magcal_origin *o) {
    return magcal_magnetometer(frame, 0, o, field_nt) + magcal_reference_magnitude(frame, 0, o, field_nt[0]);
}
#endif
#if PART == 2 /* every kind, commands */
static size_t all(const magcal_origin *o) {
    return magcal_reference_vector(frame, 0, o, field_nt, MAGCAL_ECI) +
           magcal_position(frame, 0, o, field_nt, MAGCAL_ECEF) +
           magcal_telemetry(frame, sizeof frame, 0, o, "gyro", "rad/s", field_nt, 3) +
           magcal_command(frame, sizeof frame, 0, o, "status", NULL, 0);
}
#endif
#if PART == 3 /* samples, sealed commands */
static size_t sealed(const magcal_origin *o) {
    static const uint8_t key[32];
    return magcal_sealed_command(frame, sizeof frame, 0, o, "status", NULL, 0, key, sizeof key, 1);
}
#endif
#if PART == 4 /* samples, decoder, apply */
static uint8_t held[MAGCAL_DECODER_BYTES];
static magcal_decoder decoder;
static magcal_message message;
static size_t decode(void) {
    magcal_decoder_begin(&decoder, held, sizeof held);
    while (magcal_take(&decoder, line, &message) != MAGCAL_MESSAGE) {
    }
    if (message.kind == MAGCAL_KIND_ESTIMATE) {
        magcal_apply(message.of.estimate.bias_nt, message.of.estimate.D, field_nt, field_nt);
    }
    return message.kind == MAGCAL_KIND_CALIBRATED &&
           magcal_usable(message.of.calibrated.verdict, &message.of.calibrated.protection, 500);
}
#endif

void entry(void) {
    const magcal_origin origin = {"sat1", "mag0", 0, 0, MAGCAL_CLOCK_ELAPSED};
    size_t size = 0;
    field_nt[0] = (magcal_real)line;
#if PART >= 1 && PART <= 4
    size += samples(&origin);
#endif
#if PART == 2
    size += all(&origin);
#elif PART == 3
    size += sealed(&origin);
#elif PART == 4
    size += decode();
#elif PART == 5 /* the field alone */
    size += (size_t)magcal_igrf((magcal_real)2026 + (magcal_real)line, field_nt, field_nt);
#endif
    line = (uint8_t)(size + frame[line]);
}

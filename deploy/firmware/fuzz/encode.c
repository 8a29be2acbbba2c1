/* encode.c: libFuzzer over the encoder: any names, numbers, texts and buffer sizes.
 *
 * The address sanitizer watches every access; here it is checked that a frame fits its buffer, has its only zeros at its
 * ends, and is read back as what went in. */
#define MAGCAL_DECODE_ALL
#include "magcal.h"

#include <stdio.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const uint8_t *input;
static size_t left;

static void require(int true_here, const char *what) {
    if (!true_here) {
        fprintf(stderr, "%s\n", what);
        abort();
    }
}

static uint64_t bits(size_t size) {
    uint64_t value = 0;
    while (size-- > 0 && left > 0) {
        value = value << 8 | *input++;
        left--;
    }
    return value;
}

/* A string of its own, exactly as long as it is: mostly of what a name may have. */
static char *string(size_t longest) {
    const uint64_t form = bits(2);
    const size_t size = (size_t)(form >> 2) % (longest + 1);
    char *made = (char *)malloc(size + 1);
    size_t i;
    for (i = 0; i < size; i++) made[i] = (form & 3) ? (char)('a' + (char)(bits(1) % 26)) : (char)bits(1);
    made[size] = '\0';
    return made;
}

static magcal_real real(void) {
    const uint64_t form = bits(1), raw = bits(sizeof(magcal_real));
    magcal_real value;
    memcpy(&value, &raw, sizeof value);
    return form & 3 ? (magcal_real)(int32_t)raw / (magcal_real)4096 : value;
}

static int same(magcal_real a, magcal_real b) { return memcmp(&a, &b, sizeof a) == 0; }

static void check(const uint8_t *frame, size_t size, size_t capacity, const magcal_origin *origin, int kind,
                  const magcal_real *values) {
    static uint8_t held[10300];
    static magcal_message m;
    magcal_decoder decoder;
    size_t i;
    int event = MAGCAL_NOTHING;
    require(size <= capacity && size > 2 && frame[0] == 0 && frame[size - 1] == 0, "a frame without its ends");
    magcal_decoder_begin(&decoder, held, sizeof held);
    for (i = 0; i < size; i++) {
        require(i == 0 || i == size - 1 || frame[i] != 0, "a zero within a frame");
        event = magcal_take(&decoder, frame[i], &m);
    }
    if (kind & MAGCAL_SEALED) {
        require(event == MAGCAL_REFUSAL && decoder.reason == MAGCAL_REFUSED_NO_KEY, "a sealed frame that is none");
        return;
    }
    require(event == MAGCAL_MESSAGE && m.kind == kind, "a frame that is not read back");
    require(magcal_text_is(m.craft, origin->craft) && magcal_text_is(m.source, origin->source), "another name");
    require(m.sequence == origin->sequence && m.time_ns == origin->time_ns && m.clock == origin->clock, "other numbers");
    if (kind == MAGCAL_KIND_MAGNETOMETER) require(same(m.of.magnetometer.field_body_nt[1], values[1]), "another field");
    if (kind == MAGCAL_KIND_POSITION) require(same(m.of.position.position_km[2], values[2]), "another place");
    if (kind == MAGCAL_KIND_TELEMETRY) require(same(m.of.telemetry.values[0], values[0]), "another value");
}

static size_t encode(uint8_t *frame, size_t capacity, const magcal_origin *origin, int form, const magcal_real *values,
                     int *kind) {
    magcal_argument arguments[10];
    char *name = string(40), *text = string(40);
    const size_t count = (size_t)bits(1) % 11;
    size_t size = 0, i;
    memset(arguments, 0, sizeof arguments);
    for (i = 0; i < 10; i++) {
        arguments[i].name = string(36);
        arguments[i].text = string(300);
        arguments[i].is = (int)(bits(1) % 4);
        arguments[i].number = real();
        arguments[i].integer = (int64_t)bits(8);
    }
    if (form == 0) {
        *kind = MAGCAL_KIND_MAGNETOMETER;
        size = magcal_magnetometer(frame, (uint16_t)bits(2), origin, values);
    } else if (form == 1) {
        *kind = MAGCAL_KIND_REFERENCE;
        size = magcal_reference_vector(frame, (uint16_t)bits(2), origin, values, (int)bits(1) % 5 - 1);
    } else if (form == 2) {
        *kind = MAGCAL_KIND_REFERENCE;
        size = magcal_reference_magnitude(frame, (uint16_t)bits(2), origin, values[0]);
    } else if (form == 3) {
        *kind = MAGCAL_KIND_POSITION;
        size = magcal_position(frame, (uint16_t)bits(2), origin, values, (int)bits(1) % 4 - 1);
    } else if (form == 4) {
        *kind = MAGCAL_KIND_TELEMETRY;
        size = magcal_telemetry(frame, capacity, (uint16_t)bits(2), origin, name, text, values, (size_t)bits(1) % 20);
    } else if (form == 5) {
        *kind = MAGCAL_KIND_COMMAND;
        size = magcal_command(frame, capacity, (uint16_t)bits(2), origin, name, arguments, count);
    } else {
        *kind = MAGCAL_KIND_COMMAND | MAGCAL_SEALED;
        size = magcal_sealed_command(frame, capacity, (uint16_t)bits(2), origin, name, arguments, count,
                                     (const uint8_t *)values, (size_t)bits(1) % 80, bits(8));
    }
    for (i = 0; i < 10; i++) {
        free((void *)(uintptr_t)arguments[i].name);
        free((void *)(uintptr_t)arguments[i].text);
    }
    free(name);
    free(text);
    return size;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    magcal_real values[20];
    magcal_origin origin;
    uint8_t *frame;
    size_t capacity, written, i;
    int form, kind = 0;
    char *craft, *source;
    input = data;
    left = size;
    form = (int)(bits(1) % 7);
    capacity = form < 4 ? MAGCAL_FRAME_BYTES : (size_t)bits(2) % 3000;
    craft = string(36);
    source = string(36);
    origin.craft = craft;
    origin.source = source;
    origin.sequence = (uint32_t)bits(4);
    origin.time_ns = (int64_t)bits(8);
    origin.clock = (int)bits(1) % 3;
    for (i = 0; i < 20; i++) values[i] = real();
    frame = (uint8_t *)malloc(capacity > 0 ? capacity : 1);
    written = encode(frame, capacity, &origin, form, values, &kind);
    if (written > 0) check(frame, written, capacity, &origin, kind, values);
    free(frame);
    free(craft);
    free(source);
    return 0;
}

/* decode.c: libFuzzer over the decoder: any bytes as a line, as a payload, and as a payload in a sound frame.
 *
 * The address sanitizer watches every access; here it is checked that what is accepted is within the wire's limits and
 * that a payload has one meaning, in a frame or alone, however little the decoder may hold. */
#define MAGCAL_DECODE_ALL
#include "magcal.h"

#include <stdio.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static volatile unsigned sink;

static void require(int true_here, const char *what) {
    if (!true_here) {
        fprintf(stderr, "%s\n", what);
        abort();
    }
}

static void touch(magcal_text text) {
    size_t i;
    for (i = 0; i < text.size; i++) sink += (unsigned char)text.bytes[i];
}

static void check_reals(const magcal_real *values, int count, magcal_real limit) {
    int i;
    for (i = 0; i < count; i++) require(values[i] >= -limit && values[i] <= limit, "a number beyond its limit");
}

static void check_protection(const magcal_protection *p) {
    check_reals(&p->nt, 1, (magcal_real)MAGCAL_RESULT_LIMIT_NT);
    touch(p->by.name);
}

static void check(const magcal_message *m) {
    int i;
    touch(m->craft);
    touch(m->source);
    require(m->craft.size >= 1 && m->craft.size <= MAGCAL_NAME_LENGTH, "a craft without a name");
    require(m->clock >= 0 && m->clock < MAGCAL_CLOCKS, "a clock that does not exist");
    if (m->kind == MAGCAL_KIND_CALIBRATED) {
        check_reals(m->of.calibrated.field_body_nt, 3, (magcal_real)MAGCAL_RESULT_LIMIT_NT);
        check_reals(m->of.calibrated.covariance_nt2, 6, (magcal_real)MAGCAL_COVARIANCE_LIMIT);
        check_protection(&m->of.calibrated.protection);
        (void)magcal_verdict_name(m->of.calibrated.verdict);
    } else if (m->kind == MAGCAL_KIND_ESTIMATE) {
        const magcal_estimate *e = &m->of.estimate;
        magcal_real w[3];
        check_reals(e->bias_nt, 3, (magcal_real)MAGCAL_RESULT_LIMIT_NT);
        check_reals(e->D, 6, (magcal_real)MAGCAL_D_LIMIT);
        check_reals(e->covariance, 45, (magcal_real)MAGCAL_COVARIANCE_LIMIT);
        require(e->reason_count <= MAGCAL_MAX_REASONS, "too many reasons");
        for (i = 0; i < e->reason_count; i++) touch(e->reasons[i].name);
        touch(e->method);
        touch(e->remedy);
        check_protection(&e->protection);
        magcal_apply(e->bias_nt, e->D, e->bias_nt, w);
    } else if (m->kind == MAGCAL_KIND_STATUS) {
        magcal_map counters = m->of.status.counters;
        magcal_text name;
        uint64_t count;
        unsigned seen = 0;
        while (magcal_next_counter(&counters, &name, &count)) {
            touch(name);
            seen++;
            require(count <= MAGCAL_MAX_COUNT, "a count beyond its limit");
        }
        require(seen == m->of.status.counters.left, "counters that cannot be read again");
        touch(m->of.status.text);
    } else if (m->kind == MAGCAL_KIND_REPLY) {
        touch(m->of.reply.name);
        touch(m->of.reply.command_source);
        touch(m->of.reply.text);
    } else if (m->kind == MAGCAL_KIND_TELEMETRY) {
        touch(m->of.telemetry.unit);
        check_reals(m->of.telemetry.values, m->of.telemetry.count, (magcal_real)MAGCAL_TELEMETRY_LIMIT);
    } else if (m->kind == MAGCAL_KIND_MAGNETOMETER) {
        check_reals(m->of.magnetometer.field_body_nt, 3, (magcal_real)MAGCAL_FIELD_LIMIT_NT);
    }
}

static uint8_t *copied(const uint8_t *data, size_t size) {
    uint8_t *copy = (uint8_t *)malloc(size > 0 ? size : 1);
    if (size > 0) memcpy(copy, data, size);
    return copy;
}

/* Everything that the line says; the last event that is not MAGCAL_NOTHING, and its reason. */
static int feed(const uint8_t *line, size_t size, size_t capacity, int *reason) {
    uint8_t *held = (uint8_t *)malloc(capacity);
    magcal_message *message = (magcal_message *)malloc(sizeof *message);
    magcal_decoder decoder;
    int last = MAGCAL_NOTHING;
    size_t i;
    magcal_decoder_begin(&decoder, held, capacity);
    for (i = 0; i < size; i++) {
        const int event = magcal_take(&decoder, line[i], message);
        if (event == MAGCAL_MESSAGE) check(message);
        if (event != MAGCAL_NOTHING) last = event;
    }
    *reason = decoder.reason;
    free(message);
    free(held);
    return last;
}

static void as_payload(const uint8_t *data, size_t size, size_t capacity) {
    uint8_t *payload = copied(data, size), *body, *frame;
    magcal_message message;
    const int alone = magcal_decode_payload(payload, size, &message);
    const size_t length = size + MAGCAL_HEADER_BYTES;
    uint32_t crc;
    int event, reason, i;
    if (alone == MAGCAL_ACCEPTED) check(&message);
    if (size <= MAGCAL_MAX_PAYLOAD_BYTES) {
        body = (uint8_t *)malloc(length + MAGCAL_CRC_BYTES);
        frame = (uint8_t *)malloc(MAGCAL_FRAME_FOR(size));
        body[0] = MAGCAL_FRAME_VERSION;
        body[1] = (uint8_t)(alone == MAGCAL_ACCEPTED ? message.kind : 1);
        body[2] = body[3] = 0;
        body[4] = (uint8_t)(size & 0xFF);
        body[5] = (uint8_t)(size >> 8);
        memcpy(body + MAGCAL_HEADER_BYTES, payload, size);
        crc = magcal_crc32(body, length);
        for (i = 0; i < MAGCAL_CRC_BYTES; i++) body[length + (size_t)i] = (uint8_t)(crc >> (8 * i));
        event = feed(frame, magcal_stuff(frame, body, length + MAGCAL_CRC_BYTES), capacity, &reason);
        if (length + MAGCAL_CRC_BYTES > capacity) {
            require(event == MAGCAL_SKIPPED, "a frame beyond what is held is not skipped");
        } else if (alone == MAGCAL_ACCEPTED) {
            require(event == MAGCAL_MESSAGE, "a payload is refused in its frame");
        } else {
            require(event == MAGCAL_REFUSAL && reason == alone, "a payload is refused for another reason in its frame");
        }
        free(frame);
        free(body);
    }
    free(payload);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const size_t capacities[4] = {MAGCAL_DECODER_BYTES, 10300, 64, 0};
    int reason;
    if (size < 1) return 0;
    if (data[0] & 4) {
        (void)feed(data + 1, size - 1, capacities[data[0] & 3], &reason);
    } else {
        as_payload(data + 1, size - 1, capacities[data[0] & 3]);
    }
    return 0;
}

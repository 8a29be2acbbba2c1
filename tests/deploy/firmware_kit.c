/* Decodes standard input with the firmware kit and prints, line by line:
 *     message KIND CRAFT SOURCE SEQUENCE TIME CLOCK VALUE...    each value as `show_...` writes it
 *     frame HEX                  the same message encoded again, for the kinds that a board sends
 *     sealed HEX                 the same command sealed, where a key is given
 *     refused REASON
 *     count NAME VALUE           at the end, each counter that is not 0
 * Arguments: bytes the decoder may hold; a key in hex and a counter. */
#define MAGCAL_DECODE_ALL
#include "magcal.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

static uint8_t key[MAGCAL_KEY_MOST];
static size_t key_size;
static uint64_t counter;

static void show_real(magcal_real value) {
    const double wide = (double)value;
    uint64_t bits;
    memcpy(&bits, &wide, sizeof bits);
    printf(" %016" PRIx64, bits);
}

static void show_reals(const magcal_real *values, int count) {
    int i;
    for (i = 0; i < count; i++) show_real(values[i]);
}

static void show_text(magcal_text text) {
    size_t i;
    printf(" '");
    for (i = 0; i < text.size; i++) printf("%02x", (unsigned char)text.bytes[i]);
}

static void show_protection(const magcal_protection *p) {
    if (!p->known) {
        printf(" - -");
        return;
    }
    show_real(p->nt);
    show_text(p->by.name);
    if (p->by.code != MAGCAL_UNKNOWN_NAME && !magcal_text_is(p->by.name, magcal_hazard_name(p->by.code))) abort();
}

static void show_estimate(const magcal_estimate *e) {
    int i;
    show_text(e->method);
    printf(" %" PRIu64, e->tick);
    show_reals(e->bias_nt, 3);
    show_reals(e->D, 6);
    show_reals(e->covariance, 45);
    printf(" %d %d", e->verdict, e->reason_count);
    for (i = 0; i < e->reason_count; i++) {
        const magcal_named *reason = &e->reasons[i];
        show_text(reason->name);
        if (reason->code != MAGCAL_UNKNOWN_NAME && !magcal_text_is(reason->name, magcal_reason_name(reason->code))) {
            abort();
        }
    }
    show_text(e->remedy);
    show_real(e->residual_rms_nt);
    show_real(e->noise_nt);
    printf(" %" PRIu64, e->samples_used);
    show_protection(&e->protection);
}

static void show_status(const magcal_status *s) {
    magcal_map counters = s->counters;
    magcal_text name;
    uint64_t count;
    show_real(s->uptime_s);
    printf(" %d %u", s->verdict, counters.left);
    while (magcal_next_counter(&counters, &name, &count)) {
        show_text(name);
        printf(" %" PRIu64, count);
    }
    show_text(s->text);
}

static void show_own(const magcal_message *m) {
    if (m->kind == MAGCAL_KIND_CALIBRATED) {
        show_reals(m->of.calibrated.field_body_nt, 3);
        show_reals(m->of.calibrated.covariance_nt2, 6);
        printf(" %d", m->of.calibrated.verdict);
        show_protection(&m->of.calibrated.protection);
    } else if (m->kind == MAGCAL_KIND_ESTIMATE) {
        show_estimate(&m->of.estimate);
    } else if (m->kind == MAGCAL_KIND_STATUS) {
        show_status(&m->of.status);
    } else if (m->kind == MAGCAL_KIND_REPLY) {
        show_text(m->of.reply.name);
        show_text(m->of.reply.command_source);
        printf(" %" PRIu32 " %d", m->of.reply.command_sequence, m->of.reply.accepted);
        show_text(m->of.reply.text);
    }
}

static const char *kept(magcal_text text, char *room) {
    memcpy(room, text.bytes, text.size);
    room[text.size] = '\0';
    return room;
}

static size_t arguments_of(magcal_map map, magcal_argument *arguments,
                           char room[2 * MAGCAL_MAX_ARGUMENTS][MAGCAL_ARGUMENT_TEXT_BYTES + 1]) {
    size_t i;
    const size_t count = map.left;
    for (i = 0; i < count; i++) {
        const magcal_value name = magcal_next(&map.rest), value = magcal_next(&map.rest);
        magcal_argument *a = &arguments[i];
        memset(a, 0, sizeof *a);
        a->name = kept(name.text, room[2 * i]);
        memcpy(&a->integer, &value.bits, sizeof a->integer);
        a->number = value.real;
        a->is = value.type == MAGCAL_TRUTH ? MAGCAL_IS_TRUTH : MAGCAL_IS_INTEGER;
        if (value.type == MAGCAL_REAL) a->is = MAGCAL_IS_NUMBER;
        if (value.type == MAGCAL_STRING) {
            a->is = MAGCAL_IS_TEXT;
            a->text = kept(value.text, room[2 * i + 1]);
        }
    }
    return count;
}

static void print_frame(const char *what, const uint8_t *frame, size_t size) {
    size_t i;
    printf("%s ", what);
    for (i = 0; i < size; i++) printf("%02x", frame[i]);
    printf("\n");
}

static void encode_again(const magcal_message *m, uint16_t number) {
    uint8_t frame[MAGCAL_COMMAND_FRAME_BYTES(8, MAGCAL_ARGUMENT_TEXT_BYTES)];
    char craft[64], source[64], name[64], room[2 * MAGCAL_MAX_ARGUMENTS][MAGCAL_ARGUMENT_TEXT_BYTES + 1];
    magcal_argument arguments[MAGCAL_MAX_ARGUMENTS];
    magcal_origin origin = {kept(m->craft, craft), kept(m->source, source), m->sequence, m->time_ns, m->clock};
    size_t size, count;
    if (m->kind == MAGCAL_KIND_MAGNETOMETER) {
        size = magcal_magnetometer(frame, number, &origin, m->of.magnetometer.field_body_nt);
    } else if (m->kind == MAGCAL_KIND_REFERENCE && m->of.reference.is_vector) {
        size = magcal_reference_vector(frame, number, &origin, m->of.reference.field_nt, m->of.reference.axes);
    } else if (m->kind == MAGCAL_KIND_REFERENCE) {
        size = magcal_reference_magnitude(frame, number, &origin, m->of.reference.magnitude_nt);
    } else if (m->kind == MAGCAL_KIND_POSITION) {
        size = magcal_position(frame, number, &origin, m->of.position.position_km, m->of.position.axes);
    } else if (m->kind == MAGCAL_KIND_TELEMETRY) {
        const magcal_channel *c = &m->of.telemetry;
        size = magcal_telemetry(frame, MAGCAL_TELEMETRY_FRAME_BYTES, number, &origin, kept(c->channel, name),
                                kept(c->unit, room[0]), c->values, (size_t)c->count);
    } else if (m->kind == MAGCAL_KIND_COMMAND) {
        count = arguments_of(m->of.command.arguments, arguments, room);
        size = magcal_command(frame, sizeof frame, number, &origin, kept(m->of.command.name, name), arguments, count);
        if (key_size > 0) {
            print_frame("frame", frame, size);
            size = magcal_sealed_command(frame, sizeof frame, number, &origin, name, arguments, count, key, key_size,
                                         counter);
            print_frame("sealed", frame, size);
            return;
        }
    } else {
        return;
    }
    print_frame("frame", frame, size);
}

static void show(const magcal_message *m, uint16_t number) {
    printf("message %d", m->kind);
    show_text(m->craft);
    show_text(m->source);
    printf(" %" PRIu32 " %" PRId64 " %d", m->sequence, m->time_ns, m->clock);
    show_own(m);
    printf("\n");
    encode_again(m, number);
}

static void count(const char *name, uint32_t value) {
    if (value > 0) printf("count %s %" PRIu32 "\n", name, value);
}

int main(int argc, char **argv) {
    const size_t capacity = argc > 1 ? (size_t)atol(argv[1]) : MAGCAL_DECODER_BYTES;
    uint8_t *held = (uint8_t *)malloc(capacity);
    static magcal_message message;
    magcal_decoder decoder;
    int byte, i;
    for (; argc > 3 && argv[2][2 * key_size] != '\0' && key_size < sizeof key; key_size++) {
        unsigned value;
        if (sscanf(&argv[2][2 * key_size], "%2x", &value) != 1) return 2;
        key[key_size] = (uint8_t)value;
    }
    if (argc > 3) counter = strtoull(argv[3], NULL, 10);
    magcal_decoder_begin(&decoder, held, capacity);
    while ((byte = getchar()) != EOF) {
        const int event = magcal_take(&decoder, (uint8_t)byte, &message);
        if (event == MAGCAL_MESSAGE) show(&message, (uint16_t)(decoder.expected - 1u));
        if (event == MAGCAL_REFUSAL) printf("refused %s\n", magcal_refusal_name(decoder.reason));
    }
    count("frames", decoder.frames);
    count("frames_lost", decoder.frames_lost);
    count("frame_restarts", decoder.frame_restarts);
    count("skipped", decoder.skipped);
    for (i = 0; i < MAGCAL_REFUSALS; i++) {
        char name[64];
        sprintf(name, "refused.%s", magcal_refusal_name(i));
        count(name, decoder.refused[i]);
    }
    free(held);
    return 0;
}

/* board.c: 10 samples a second out, calibrated vectors, estimates and answers back.
 *
 * Everything but the sensor is as on a real board: read the line, take its bytes, use the messages, send the samples.
 */
#include "board.h"

#include <inttypes.h>
#include <stdio.h>

#include "magcal.h"
#include "port.h"
#include "world.h"

#define KEPT 512         /* samples whose truth is kept until their vector comes back */
#define MOST_AHEAD 20    /* samples on the way where the speed is 0 */
#define SECOND_NS INT64_C(1000000000)
#define PATIENCE_NS (2 * SECOND_NS)
#define HZ 10
#define LIMIT_NT 500  /* protection level to steer by */
#define WRONG_NT 1000 /* no noise of this sensor explains such an error of a vector that is usable */

typedef struct {
    const board_options *options;
    magcal_decoder decoder;
    uint8_t held[4096]; /* a status of this daemon has about 2 kB; MAGCAL_DECODER_BYTES skips it */
    magcal_message message;
    world world;
    float truth_nt[KEPT][3];
    magcal_real measured_nt[KEPT][3];
    uint32_t random, flipped; /* the cable's noise */
    uint16_t frame_sequence;
    uint32_t samples, unsent, vectors, estimates, statuses, replies, usable, wrong;
    uint32_t answered; /* one above the newest sample that was answered or given up */
    int64_t start_ns, answered_at_ns;
    double square_nt2, compared; /* of the usable vectors' errors */
    int verdict;
    magcal_real protection_nt; /* -1 while unknown */
    const char *hazard;
    magcal_real bias_nt[3], D[6];
    double apart_nt; /* the most between magcal_apply here and the daemon's vector, by the newest estimate */
} board;

static board b;

static uint8_t through_the_cable(uint8_t byte) {
    if (b.options->noise == 0) return byte;
    b.random ^= b.random << 13;
    b.random ^= b.random >> 17;
    b.random ^= b.random << 5;
    if (b.random % b.options->noise != 0) return byte;
    b.flipped++;
    return (uint8_t)(byte ^ (1u << (b.random >> 29)));
}

static void send(uint8_t *frame, size_t size, uint32_t *sequence) {
    size_t i;
    if (size == 0) {
        b.unsent++;
        return;
    }
    for (i = 0; i < size; i++) frame[i] = through_the_cable(frame[i]);
    port_write(frame, size);
    (*sequence)++;
    b.frame_sequence++;
}

static void send_command(const char *name, magcal_origin *from) {
    uint8_t frame[MAGCAL_COMMAND_FRAME_BYTES(0, 0)];
    const board_options *o = b.options;
    size_t size;
    from->time_ns = port_time_ns();
    if (o->key_size > 0) {
        size = magcal_sealed_command(frame, sizeof frame, b.frame_sequence, from, name, NULL, 0, o->key, o->key_size,
                                     o->counter + from->sequence);
    } else {
        size = magcal_command(frame, sizeof frame, b.frame_sequence, from, name, NULL, 0);
    }
    send(frame, size, &from->sequence);
}

/* The board can calibrate by itself: the newest estimate gives the daemon's own vector. */
static void calibrate_here(const magcal_calibrated *c, const magcal_real measured_nt[3]) {
    magcal_real here_nt[3];
    int i;
    if (b.estimates == 0) return;
    magcal_apply(b.bias_nt, b.D, measured_nt, here_nt);
    for (i = 0; i < 3; i++) {
        const double apart_nt = (double)(here_nt[i] - c->field_body_nt[i]);
        if (apart_nt > b.apart_nt) b.apart_nt = apart_nt;
        if (-apart_nt > b.apart_nt) b.apart_nt = -apart_nt;
    }
}

static void use_vector(const magcal_message *m) {
    const magcal_calibrated *c = &m->of.calibrated;
    const float *truth_nt = b.truth_nt[m->sequence % KEPT];
    int i;
    if (m->sequence >= b.samples) return; /* answers a sample of before this start */
    b.vectors++;
    b.answered = m->sequence + 1u;
    b.answered_at_ns = port_time_ns() - b.start_ns;
    b.verdict = c->verdict;
    b.protection_nt = c->protection.known ? c->protection.nt : (magcal_real)-1;
    b.hazard = c->protection.known ? magcal_hazard_name(c->protection.by.code) : "";
    if (b.samples - m->sequence > KEPT) return;
    calibrate_here(c, b.measured_nt[m->sequence % KEPT]);
    if (!magcal_usable(c->verdict, &c->protection, (magcal_real)LIMIT_NT)) return;
    b.usable++;
    for (i = 0; i < 3; i++) {
        const double error_nt = (double)c->field_body_nt[i] - (double)truth_nt[i];
        b.square_nt2 += error_nt * error_nt;
        b.compared += 1.0;
        if (error_nt > WRONG_NT || error_nt < -WRONG_NT) b.wrong++;
    }
}

static void use_estimate(const magcal_estimate *e) {
    memcpy(b.bias_nt, e->bias_nt, sizeof b.bias_nt);
    memcpy(b.D, e->D, sizeof b.D);
    b.estimates++;
}

static void use(const magcal_message *m) {
    if (m->kind == MAGCAL_KIND_CALIBRATED) {
        use_vector(m);
    } else if (m->kind == MAGCAL_KIND_ESTIMATE) {
        use_estimate(&m->of.estimate);
    } else if (m->kind == MAGCAL_KIND_STATUS) {
        b.statuses++;
    } else if (m->kind == MAGCAL_KIND_REPLY) {
        const magcal_reply *r = &m->of.reply;
        b.replies++;
            printf("reply to %.*s: %s %.*s\n", (int)r->name.size, r->name.bytes, r->accepted ? "done" : "refused",
               (int)r->text.size, r->text.bytes);
    }
}

static void read_line(void) {
    uint8_t byte;
    while (port_read(&byte)) {
        if (magcal_take(&b.decoder, through_the_cable(byte), &b.message) == MAGCAL_MESSAGE) use(&b.message);
    }
}

static void tell(long second) {
    printf("%ld s: %" PRIu32 " samples, %" PRIu32 " vectors, %s, protection ", second, b.samples, b.vectors,
           magcal_verdict_name(b.verdict));
    if (b.protection_nt < 0) {
        printf("none yet");
    } else {
        printf("%.1f nT by %s", (double)b.protection_nt, b.hazard);
    }
    if (b.estimates == 0) {
        printf(", no estimate yet\n");
    } else {
        printf(", bias %.1f %.1f %.1f nT\n", (double)b.bias_nt[0], (double)b.bias_nt[1], (double)b.bias_nt[2]);
    }
    fflush(stdout);
}

static void tell_usable(void) {
    const double mean_nt2 = b.compared > 0.0 ? b.square_nt2 / b.compared : 0.0;
    double rms_nt = mean_nt2 > 1.0 ? mean_nt2 : 1.0;
    int i;
    if (b.usable == 0) {
        printf("usable vectors: none\n");
        return;
    }
    for (i = 0; i < 60; i++) rms_nt = 0.5 * (rms_nt + mean_nt2 / rms_nt);
    printf("usable vectors: %" PRIu32 ", rms error per axis %.1f nT (sensor noise %.0f nT), wrong %" PRIu32 "\n", b.usable,
           rms_nt, WORLD_NOISE_NT, b.wrong);
}

static void tell_counts(void) {
    int i;
    printf("sent: samples %" PRIu32 ", refused here %" PRIu32 "\n", b.samples, b.unsent);
    printf("back: vectors %" PRIu32 ", estimates %" PRIu32 ", statuses %" PRIu32 ", replies %" PRIu32 "\n", b.vectors,
           b.estimates, b.statuses, b.replies);
    tell_usable();
    if (b.estimates > 0) printf("calibrated here: at most %.6f nT from the daemon's vectors\n", b.apart_nt);
    printf("line: frames %" PRIu32 ", lost %" PRIu32 ", restarts %" PRIu32 ", skipped %" PRIu32 ", bad %" PRIu32
           ", bytes flipped by the cable %" PRIu32 "\n",
           b.decoder.frames, b.decoder.frames_lost, b.decoder.frame_restarts, b.decoder.skipped,
           magcal_refusals(&b.decoder), b.flipped);
    for (i = 0; i < MAGCAL_REFUSALS; i++) {
        if (b.decoder.refused[i] > 0) printf("bad: %s %" PRIu32 "\n", magcal_refusal_name(i), b.decoder.refused[i]);
    }
}

/* Asks until somebody answers: before that, what is sent is lost. */
static void wait_for_daemon(void) {
    magcal_origin from = {b.options->craft, "board", 0, 0, MAGCAL_CLOCK_ELAPSED};
    printf("waiting for the daemon\n");
    fflush(stdout);
    while (b.replies == 0) {
        const int64_t until_ns = port_time_ns() + SECOND_NS;
        send_command("status", &from);
        while (b.replies == 0 && port_time_ns() < until_ns) {
            read_line();
            port_idle();
        }
    }
    b.start_ns = port_time_ns();
}

/* Until this sample is due: by the clock, or by the answers where the speed is 0. */
static void wait_for_turn(int64_t elapsed_ns) {
    const int64_t due_ns = b.options->speed > 0 ? elapsed_ns / b.options->speed : 0;
    for (;;) {
        const int64_t now_ns = port_time_ns() - b.start_ns;
        const int ahead = b.options->speed == 0 && b.samples - b.answered > MOST_AHEAD;
        read_line();
        if (now_ns >= due_ns && !ahead) return;
        port_idle();
        if (ahead && now_ns - b.answered_at_ns > PATIENCE_NS) {
            b.answered = b.samples; /* lost on the way, or the daemon is away */
            b.answered_at_ns = now_ns;
        }
    }
}

int board_run(const board_options *options) {
    const int64_t period_ns = SECOND_NS / HZ;
    magcal_origin measured = {options->craft, "mag0", 0, 0, MAGCAL_CLOCK_ELAPSED};
    magcal_origin reference = {options->craft, "model", 0, 0, MAGCAL_CLOCK_ELAPSED};
    magcal_origin housekeeping = {options->craft, "board", 0, 0, MAGCAL_CLOCK_ELAPSED};
    uint8_t frame[MAGCAL_TELEMETRY_FRAME_BYTES];
    const magcal_real temperature_degc = 20;
    long i;
    int64_t until_ns;
    b.options = options;
    b.random = 88172645u;
    b.protection_nt = -1;
    magcal_decoder_begin(&b.decoder, b.held, sizeof b.held);
    world_begin(&b.world);
    wait_for_daemon();
    for (i = 0; i < options->seconds * HZ; i++) {
        int axis;
        magcal_real field_body_nt[3];
        wait_for_turn(i * period_ns);
        world_step(&b.world);
        for (axis = 0; axis < 3; axis++) {
            b.truth_nt[measured.sequence % KEPT][axis] = (float)b.world.field_body_nt[axis];
            field_body_nt[axis] = (magcal_real)b.world.measured_body_nt[axis];
            b.measured_nt[measured.sequence % KEPT][axis] = field_body_nt[axis];
        }
        measured.time_ns = reference.time_ns = housekeeping.time_ns = i * period_ns;
        if (i % HZ == 0) {
            send(frame, magcal_reference_magnitude(frame, b.frame_sequence, &reference, (magcal_real)b.world.magnitude_nt),
                 &reference.sequence);
            send(frame,
                 magcal_telemetry(frame, sizeof frame, b.frame_sequence, &housekeeping, "temperature", "degC",
                                  &temperature_degc, 1),
                 &housekeeping.sequence);
        }
        send(frame, magcal_magnetometer(frame, b.frame_sequence, &measured, field_body_nt), &measured.sequence);
        b.samples = measured.sequence;
        if ((i + 1) % (60 * HZ) == 0) tell((i + 1) / HZ);
    }
    until_ns = port_time_ns() + PATIENCE_NS;
    while (b.answered < b.samples && port_time_ns() < until_ns) {
        read_line();
        port_idle();
    }
    tell_counts();
    return b.vectors > 0 ? 0 : 1;
}

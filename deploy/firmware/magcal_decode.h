/* magcal_decode.h: what the daemon sends back, byte by byte from the line to typed messages.
 *
 *     static uint8_t held[MAGCAL_DECODER_BYTES];
 *     static magcal_message message;
 *     magcal_decoder decoder;
 *     magcal_decoder_begin(&decoder, held, sizeof held);
 *     ...
 *     while (uart_read(&byte)) {
 *         if (magcal_take(&decoder, byte, &message) == MAGCAL_MESSAGE) {
 *             if (message.kind == MAGCAL_KIND_CALIBRATED) use(message.of.calibrated.field_body_nt);
 *         }
 *     }
 *
 * C99, no allocation, no state but the decoder's.  Whatever arrives, nothing outside `held` and `message` is written,
 * nothing outside `held` is read, and the next whole frame is found.  What is refused is counted in
 * `decoder.refused[]` by the reasons of docs/wire.md (MAGCAL_REFUSED_...).
 *
 * Texts and counters in a message point into `held`: use or copy them before the next byte is taken.
 *
 * Kinds that only boards send are refused as `unknown_kind`.  Define MAGCAL_DECODE_ALL before including to take them
 * too, on a gateway say.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MAGCAL_DECODE_H
#define MAGCAL_DECODE_H

#include "magcal_encode.h"
#include "magcal_messages.h"
#include "magcal_msgpack.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Holds every vector, every reply, and every estimate; a longer status is counted as `skipped`.  At least 10. */
#define MAGCAL_DECODER_BYTES 2048

enum { MAGCAL_NOTHING, MAGCAL_MESSAGE, MAGCAL_REFUSAL, MAGCAL_SKIPPED };

/* What stands on the line so far since the last delimiter, and what came before, in counts. */
typedef struct {
    uint8_t *held;
    size_t capacity;
    size_t size;     /* bytes of this run after COBS, held or not */
    size_t run;      /* bytes of this run on the line */
    uint32_t crc;    /* of all of them */
    unsigned code;   /* COBS: length of the block begun */
    unsigned left;   /* COBS: bytes of it still to come */
    uint16_t expected;
    int heard;
    uint32_t frames;                   /* whole frames with a right checksum */
    uint32_t frames_lost;              /* gaps of the frame sequence */
    uint32_t frame_restarts;           /* jumps of it beyond 1024: a sender that began anew */
    uint32_t skipped;                  /* whole frames longer than `held` */
    uint32_t refused[MAGCAL_REFUSALS]; /* by reason */
    int reason;                        /* of the last MAGCAL_REFUSAL */
} magcal_decoder;

static inline void magcal_decoder_begin(magcal_decoder *d, uint8_t *held, size_t capacity) {
    memset(d, 0, sizeof *d);
    d->held = held;
    d->capacity = capacity;
    d->crc = 0xFFFFFFFFu;
}

/* All refusals together: 0 on a clean line. */
static inline uint32_t magcal_refusals(const magcal_decoder *d) {
    uint32_t sum = 0;
    int i;
    for (i = 0; i < MAGCAL_REFUSALS; i++) sum += d->refused[i];
    return sum;
}

static inline void magcal_hold(magcal_decoder *d, uint8_t byte) {
    if (d->size < d->capacity) d->held[d->size] = byte;
    d->size++;
    d->crc = magcal_crc32_step(d->crc, byte);
}

static inline int magcal_refuse(magcal_decoder *d, int reason) {
    d->refused[reason]++;
    d->reason = reason;
    return MAGCAL_REFUSAL;
}

static inline void magcal_count_frame(magcal_decoder *d, uint16_t sequence) {
    const uint16_t gap = d->heard ? (uint16_t)(sequence - d->expected) : 0;
    d->frames++;
    d->heard = 1;
    d->expected = (uint16_t)(sequence + 1);
    if (gap > MAGCAL_MAX_GAP) {
        d->frame_restarts++;
    } else {
        d->frames_lost += gap;
    }
}

/* What stood between two delimiters. */
static inline int magcal_finish(magcal_decoder *d, magcal_message *message) {
    const size_t around = MAGCAL_HEADER_BYTES + MAGCAL_CRC_BYTES, size = d->size;
    const uint8_t *h = d->held;
    int reason;
    if (d->left > 0) return magcal_refuse(d, MAGCAL_REFUSED_BAD_COBS);
    if (size < around) return magcal_refuse(d, MAGCAL_REFUSED_BAD_LENGTH);
    if (d->crc != 0xDEBB20E3u) return magcal_refuse(d, MAGCAL_REFUSED_BAD_CRC); /* of anything and its own CRC */
    if (d->capacity < around) {
        d->skipped++;
        return MAGCAL_SKIPPED;
    }
    if (h[0] != MAGCAL_FRAME_VERSION) return magcal_refuse(d, MAGCAL_REFUSED_UNKNOWN_FRAME_VERSION);
    if (size - around != (h[4] | (size_t)h[5] << 8)) return magcal_refuse(d, MAGCAL_REFUSED_BAD_LENGTH);
    magcal_count_frame(d, (uint16_t)(h[2] | (unsigned)h[3] << 8));
    if (size > d->capacity) {
        d->skipped++;
        return MAGCAL_SKIPPED;
    }
    if (h[1] & MAGCAL_SEALED) return magcal_refuse(d, MAGCAL_REFUSED_NO_KEY); /* this end checks no seals */
    reason = magcal_decode_payload(h + MAGCAL_HEADER_BYTES, size - around, message);
    if (reason == MAGCAL_ACCEPTED && message->kind != h[1]) reason = MAGCAL_REFUSED_WRONG_KIND;
    return reason == MAGCAL_ACCEPTED ? MAGCAL_MESSAGE : magcal_refuse(d, reason);
}

static inline void magcal_unstuff(magcal_decoder *d, uint8_t byte) {
    if (d->left > 0) {
        d->left--;
        magcal_hold(d, byte);
        return;
    }
    if (d->run > 1 && d->code != 255) magcal_hold(d, 0);
    d->code = byte;
    d->left = byte - 1u;
}

/* The next byte of the line.  MAGCAL_MESSAGE: it completed a message, which is in `message`; MAGCAL_REFUSAL: it ended
 * something that is refused for `d->reason`; MAGCAL_SKIPPED: a whole frame longer than `held`; else MAGCAL_NOTHING. */
static inline int magcal_take(magcal_decoder *d, uint8_t byte, magcal_message *message) {
    int event = MAGCAL_NOTHING;
    if (byte != 0) {
        if (d->run > MAGCAL_MAX_ENCODED_BYTES) return MAGCAL_NOTHING;
        d->run++;
        if (d->run > MAGCAL_MAX_ENCODED_BYTES) return magcal_refuse(d, MAGCAL_REFUSED_OVERSIZE);
        magcal_unstuff(d, byte);
        return MAGCAL_NOTHING;
    }
    if (d->run > 0 && d->run <= MAGCAL_MAX_ENCODED_BYTES) event = magcal_finish(d, message);
    d->size = d->run = 0;
    d->crc = 0xFFFFFFFFu;
    d->left = d->code = 0;
    return event;
}

#ifdef __cplusplus
}
#endif

#endif

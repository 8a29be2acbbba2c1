/* magcal_encode.h: magnetometer and reference samples as complete serial frames for magcal.
 *
 * One header, C99, no allocation, no library beyond <stdint.h>, <stddef.h> and <string.h>, no state.
 * The bytes are specified in docs/wire.md; the golden frames there are this header's test.
 *
 *     uint8_t frame[MAGCAL_FRAME_BYTES];
 *     magcal_origin origin = {"sat1", "mag0", sequence, time_ns, MAGCAL_CLOCK_ELAPSED};
 *     magcal_real field_body_nt[3] = {21500.25, -13000.5, 38250.0};
 *     size_t size = magcal_magnetometer(frame, frame_sequence, &origin, field_body_nt);
 *     if (size > 0) { uart_write(frame, size); sequence++; frame_sequence++; }
 *
 * Every function returns the number of bytes written, at most MAGCAL_FRAME_BYTES, or 0 where the daemon would
 * refuse the sample: a name outside A-Z a-z 0-9 _ - or not of 1 to 32 characters, a number that is not finite,
 * a field above 1 mT, a clock or frame that does not exist.  Nothing is sent then, and the caller should count it.
 *
 * Numbers go out in double precision.  Define MAGCAL_SINGLE_PRECISION before including for 32-bit numbers (also
 * where `double` has 32 bits): a sample is 12 bytes shorter and resolves 0.004 nT at 60000 nT.
 *
 * Time is the instant of the measurement, not of sending: 1 s of error costs up to 73 nT of reference in orbit.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MAGCAL_ENCODE_H
#define MAGCAL_ENCODE_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

#define MAGCAL_NAME_LENGTH 32
#define MAGCAL_FIELD_LIMIT_NT 1000000.0

/* Sizes, largest case: array, version, kind; two names; sequence; time; clock; vector, frame, nil. */
#define MAGCAL_PAYLOAD_BYTES (3 + 2 * (2 + MAGCAL_NAME_LENGTH) + 5 + 9 + 1 + (1 + 3 * 9) + 2)
#define MAGCAL_HEADER_BYTES 6
#define MAGCAL_BODY_BYTES (MAGCAL_HEADER_BYTES + MAGCAL_PAYLOAD_BYTES + 4)
/* COBS adds one byte below 254; a delimiter stands on either side. */
#define MAGCAL_FRAME_BYTES (MAGCAL_BODY_BYTES + 3)

#ifdef MAGCAL_SINGLE_PRECISION
typedef float magcal_real;
typedef uint32_t magcal_bits;
#define MAGCAL_REAL_MARK 0xCA
#define MAGCAL_EXPONENT 0x7F800000u
#else
typedef double magcal_real;
typedef uint64_t magcal_bits;
#define MAGCAL_REAL_MARK 0xCB
#define MAGCAL_EXPONENT 0x7FF0000000000000u
#endif

/* A negative array size stops the build: the body must fit one COBS block, and the real must be IEEE 754's size. */
typedef char magcal_assert_body[MAGCAL_BODY_BYTES < 254 ? 1 : -1];
typedef char magcal_assert_real[sizeof(magcal_real) == sizeof(magcal_bits) ? 1 : -1];

enum { MAGCAL_CLOCK_UTC = 0, MAGCAL_CLOCK_ELAPSED = 1 };
enum { MAGCAL_ECI = 0, MAGCAL_ECEF = 1, MAGCAL_NED = 2 };

/* Where and when a sample comes from.
 * craft, source: 1 to 32 characters of A-Z a-z 0-9 _ -, the source unique within the craft.
 * sequence: counts the samples of one kind from this source; the daemon sees losses by it.
 * time_ns: time of the measurement [ns] since 1970-01-01 UTC (leap seconds ignored), or since the source's start.
 * clock: which of the two, MAGCAL_CLOCK_UTC or MAGCAL_CLOCK_ELAPSED. */
typedef struct {
    const char *craft;
    const char *source;
    uint32_t sequence;
    int64_t time_ns;
    int clock;
} magcal_origin;

/* A payload being written after the space for the frame header. */
typedef struct {
    uint8_t bytes[MAGCAL_BODY_BYTES];
    size_t size;
    int refused;
} magcal_writer;

static inline void magcal_put(magcal_writer *w, unsigned value) { w->bytes[w->size++] = (uint8_t)(value & 0xFFu); }

static inline void magcal_put_big_endian(magcal_writer *w, uint64_t value, int bytes) {
    while (bytes-- > 0) magcal_put(w, (unsigned)((value >> (8 * bytes)) & 0xFFu));
}

static inline void magcal_put_unsigned(magcal_writer *w, uint64_t value) {
    if (value < 0x80u) {
        magcal_put(w, (unsigned)value);
    } else if (value <= 0xFFu) {
        magcal_put(w, 0xCC);
        magcal_put_big_endian(w, value, 1);
    } else if (value <= 0xFFFFu) {
        magcal_put(w, 0xCD);
        magcal_put_big_endian(w, value, 2);
    } else if (value <= 0xFFFFFFFFu) {
        magcal_put(w, 0xCE);
        magcal_put_big_endian(w, value, 4);
    } else {
        magcal_put(w, 0xCF);
        magcal_put_big_endian(w, value, 8);
    }
}

static inline void magcal_put_signed(magcal_writer *w, int64_t value) {
    const uint64_t bits = (uint64_t)value; /* two's complement, whatever the machine */
    if (value >= 0) {
        magcal_put_unsigned(w, bits);
    } else if (value >= -32) {
        magcal_put_big_endian(w, bits, 1);
    } else if (value >= INT8_MIN) {
        magcal_put(w, 0xD0);
        magcal_put_big_endian(w, bits, 1);
    } else if (value >= INT16_MIN) {
        magcal_put(w, 0xD1);
        magcal_put_big_endian(w, bits, 2);
    } else if (value >= INT32_MIN) {
        magcal_put(w, 0xD2);
        magcal_put_big_endian(w, bits, 4);
    } else {
        magcal_put(w, 0xD3);
        magcal_put_big_endian(w, bits, 8);
    }
}

/* The exponent is looked at in the bits, because -ffast-math lets a compiler drop comparisons with NaN. */
static inline void magcal_put_real(magcal_writer *w, magcal_real value) {
    magcal_bits bits;
    memcpy(&bits, &value, sizeof bits);
    if ((bits & MAGCAL_EXPONENT) == MAGCAL_EXPONENT) w->refused = 1;
    magcal_put(w, MAGCAL_REAL_MARK);
    magcal_put_big_endian(w, bits, (int)sizeof bits);
}

static inline void magcal_put_vector(magcal_writer *w, const magcal_real v[3]) {
    const magcal_real limit = (magcal_real)MAGCAL_FIELD_LIMIT_NT;
    int i;
    magcal_put(w, 0x93);
    for (i = 0; i < 3; i++) {
        magcal_put_real(w, v[i]);
        if (v[i] > limit || v[i] < -limit) w->refused = 1;
    }
    if (!w->refused && v[0] * v[0] + v[1] * v[1] + v[2] * v[2] > limit * limit) w->refused = 1;
}

static inline int magcal_is_name_character(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
}

static inline void magcal_put_name(magcal_writer *w, const char *name) {
    size_t length = 0, i;
    while (name != NULL && length <= MAGCAL_NAME_LENGTH && magcal_is_name_character(name[length])) length++;
    if (length == 0 || length > MAGCAL_NAME_LENGTH || name[length] != '\0') {
        w->refused = 1;
        return;
    }
    if (length == 32) magcal_put(w, 0xD9);
    magcal_put(w, length == 32 ? 32u : 0xA0u + (unsigned)length);
    for (i = 0; i < length; i++) magcal_put(w, (unsigned char)name[i]);
}

/* The seven values that every message begins with; `length` counts all of the message's values. */
static inline void magcal_begin(magcal_writer *w, int length, int kind, const magcal_origin *origin) {
    w->size = MAGCAL_HEADER_BYTES;
    w->refused = origin->clock != MAGCAL_CLOCK_UTC && origin->clock != MAGCAL_CLOCK_ELAPSED;
    magcal_put(w, 0x90u + (unsigned)length);
    magcal_put(w, 1);
    magcal_put(w, (unsigned)kind);
    magcal_put_name(w, origin->craft);
    magcal_put_name(w, origin->source);
    magcal_put_unsigned(w, origin->sequence);
    magcal_put_signed(w, origin->time_ns);
    magcal_put(w, (unsigned)origin->clock);
}

/* CRC-32 of Ethernet and zlib, bit by bit: 8 steps a byte, no table. */
static inline uint32_t magcal_crc32(const uint8_t *bytes, size_t size) {
    uint32_t crc = 0xFFFFFFFFu;
    int bit;
    while (size-- > 0) {
        crc ^= *bytes++;
        for (bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ ((crc & 1u) ? 0xEDB88320u : 0u);
    }
    return crc ^ 0xFFFFFFFFu;
}

/* COBS between two delimiters, for fewer than 254 bytes. */
static inline size_t magcal_stuff(uint8_t *frame, const uint8_t *bytes, size_t size) {
    size_t code_at = 1, at = 2, i;
    frame[0] = 0;
    for (i = 0; i < size; i++) {
        if (bytes[i] == 0) {
            frame[code_at] = (uint8_t)(at - code_at);
            code_at = at++;
        } else {
            frame[at++] = bytes[i];
        }
    }
    frame[code_at] = (uint8_t)(at - code_at);
    frame[at++] = 0;
    return at;
}

static inline size_t magcal_end(magcal_writer *w, uint8_t frame[MAGCAL_FRAME_BYTES], uint16_t frame_sequence, int kind) {
    const size_t length = w->size - MAGCAL_HEADER_BYTES;
    uint32_t crc;
    int i;
    if (w->refused) return 0;
    w->bytes[0] = 1;
    w->bytes[1] = (uint8_t)kind;
    w->bytes[2] = (uint8_t)(frame_sequence & 0xFFu);
    w->bytes[3] = (uint8_t)(frame_sequence >> 8);
    w->bytes[4] = (uint8_t)(length & 0xFFu);
    w->bytes[5] = (uint8_t)(length >> 8);
    crc = magcal_crc32(w->bytes, w->size);
    for (i = 0; i < 4; i++) magcal_put(w, (unsigned)((crc >> (8 * i)) & 0xFFu));
    return magcal_stuff(frame, w->bytes, w->size);
}

/* A measured vector in the sensor's own axes [nT].  `frame_sequence` counts all frames on this line. */
static inline size_t magcal_magnetometer(uint8_t frame[MAGCAL_FRAME_BYTES], uint16_t frame_sequence,
                                         const magcal_origin *origin, const magcal_real field_body_nt[3]) {
    magcal_writer w;
    magcal_begin(&w, 8, 1, origin);
    magcal_put_vector(&w, field_body_nt);
    return magcal_end(&w, frame, frame_sequence, 1);
}

/* The reference field as a vector [nT] in `axes`: MAGCAL_ECI, MAGCAL_ECEF or MAGCAL_NED. */
static inline size_t magcal_reference_vector(uint8_t frame[MAGCAL_FRAME_BYTES], uint16_t frame_sequence,
                                             const magcal_origin *origin, const magcal_real field_nt[3], int axes) {
    magcal_writer w;
    magcal_begin(&w, 10, 2, origin);
    magcal_put_vector(&w, field_nt);
    magcal_put(&w, (unsigned)axes);
    magcal_put(&w, 0xC0);
    if (axes < MAGCAL_ECI || axes > MAGCAL_NED) w.refused = 1;
    return magcal_end(&w, frame, frame_sequence, 2);
}

/* The magnitude of the reference field alone [nT], 0 or more. */
static inline size_t magcal_reference_magnitude(uint8_t frame[MAGCAL_FRAME_BYTES], uint16_t frame_sequence,
                                                const magcal_origin *origin, magcal_real magnitude_nt) {
    magcal_writer w;
    magcal_begin(&w, 10, 2, origin);
    magcal_put(&w, 0xC0);
    magcal_put(&w, 0xC0);
    magcal_put_real(&w, magnitude_nt);
    if (magnitude_nt < 0 || magnitude_nt > (magcal_real)MAGCAL_FIELD_LIMIT_NT) w.refused = 1;
    return magcal_end(&w, frame, frame_sequence, 2);
}

#ifdef __cplusplus
}
#endif

#endif
